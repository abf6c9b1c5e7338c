"""One worker process: started, spoken to, listened to, weighed and ended."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import psutil

from geometry.files import open_in_place
from render.blender.worker import ANSWER
from render.confinement import Confinement

WORKER = Path(__file__).with_name("blender") / "worker.py"
STOP_S = 5.0  # what a worker gets to end by itself
LOG_TAIL = 2000  # bytes of the log in which last words are looked for
# For glibc: from how many bytes on a block goes back to the system when it is freed. This is its own first value; left
# alone it raises it to the largest block yet, and other HDRIs and vehicles leave holes: 100 MB more, 7 % growth.
STEADY_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**17)}


def worker_command(blender: str | None) -> list[str]:
    """How to start a worker: in this Python, which has the bpy module, or in an installed Blender."""
    if blender is None:
        return [sys.executable, "-P", str(WORKER)]
    options = ["--background", "--factory-startup", "--disable-autoexec", "--python-exit-code", "1"]
    return [blender, *options, "--python", str(WORKER)]


class WorkerProcess:
    """A running worker.

    Parameters
    ----------
    command
        See `worker_command`.
    log
        File that its messages are added to.
    hear
        Called from another thread with the process and each of its answers, and with None when it has ended.
    confinement
        What it may read and write; None for everything.
    """

    def __init__(
        self,
        command: Sequence[str],
        log: Path,
        hear: Callable[[WorkerProcess, dict[str, Any] | None], None],
        confinement: Confinement | None = None,
    ) -> None:
        self.log = log
        log.parent.mkdir(parents=True, exist_ok=True)
        if log.is_symlink():
            log.unlink()
        with open_in_place(log) as file:
            self._log_start = file.tell()
            # A session of its own: Ctrl-C in the terminal reaches the supervisor alone, which then stops its workers.
            self._process = subprocess.Popen(
                list(command) if confinement is None else confinement.of(command),
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=file,
                env={**STEADY_MEMORY, **os.environ, **(confinement.environment if confinement else {})},
                start_new_session=True,
            )
        self._hear = hear
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            text = line.decode("utf-8", "replace")
            if text.startswith(ANSWER):
                with contextlib.suppress(json.JSONDecodeError):  # half a line of a worker that was killed
                    self._hear(self, json.loads(text[len(ANSWER) :]))
        self._hear(self, None)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def memory(self) -> int:
        """Bytes of memory that it holds; 0 if it is gone."""
        try:
            return int(psutil.Process(self.pid).memory_info().rss)
        except psutil.Error:
            return 0

    def send(self, message: Mapping[str, Any]) -> None:
        """Give it a job."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # it has just died, which the end of its stdout tells
            self._process.stdin.write(json.dumps(message).encode() + b"\n")

    def last_words(self) -> str:
        """How it ended, and the last line of its log."""
        code = self._process.wait()
        how = f"Blender ended by signal {-code}" if code < 0 else f"Blender ended with exit code {code}"
        with self.log.open("rb") as file:
            file.seek(max(self._log_start, self.log.stat().st_size - LOG_TAIL))
            lines = file.read().decode("utf-8", "replace").strip().splitlines()
        return f"{how}; its last words: {lines[-1][:300]}" if lines else how

    def close_stdin(self) -> None:
        """Tell the process that its parent is done with it: it ends, even in the middle of a job."""
        assert self._process.stdin is not None
        self._process.stdin.close()

    def stop(self) -> None:
        """Let it end by itself, if it is idle."""
        self.close_stdin()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(STOP_S)
        self.kill()

    def kill(self) -> None:
        """End it now."""
        self._process.kill()
        self._process.wait()
        self._listener.join(STOP_S)
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            with contextlib.suppress(OSError):
                stream.close()
