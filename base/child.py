"""A supervised child process with pipes, a memory count, and a sure end."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import psutil

from hulldown.base.files import open_file_to_append

MAX_LISTENER_WAIT_S = 2.0  # the child's own processes may still hold the pipe
MAX_LINE_BYTES = 1 << 20
LOG_TAIL_BYTES = 2000  # the log's last line is searched for in these


class Stopped(Exception):
    """Raised where the caller no longer needs a job's result."""


class Child:
    """A running child process. Leaving it as a context kills it.

    It has a session of its own, so that Ctrl-C reaches this process alone. Its stdin ends when this process does, even
    by ``kill -9``; see `end_with_parent`. Its stderr is appended to `log`, or goes to `on_line` too.
    """

    def __init__(
        self, command: Sequence[str], *, env: Mapping[str, str], on_line: Callable[[bytes], None], log: Path | None = None
    ) -> None:
        self._log, self._on_line = log, on_line
        self._log_start = 0
        with contextlib.ExitStack() as stack:
            errors: int = subprocess.STDOUT
            if log is not None:
                file = stack.enter_context(open_file_to_append(log))
                self._log_start = log.stat().st_size
                errors = file.fileno()
            self._process = subprocess.Popen(
                list(command),
                env=dict(env),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
            )
        self._listener = threading.Thread(target=self._forward_output_lines, daemon=True)
        self._listener.start()

    def _forward_output_lines(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            while line := lines.readline(MAX_LINE_BYTES):
                self._on_line(line)
        self._on_line(b"")

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def code(self) -> int | None:
        """Its exit code, negative for a signal; None while it runs."""
        return self._process.poll()

    @property
    def memory(self) -> int:
        """Bytes of memory in use; 0 after its end."""
        try:
            return int(psutil.Process(self.pid).memory_info().rss)
        except psutil.Error:
            return 0

    def write(self, line: bytes) -> None:
        """Write to its stdin; `on_line` gets the empty line if the process has just ended."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.write(line)
            self._process.stdin.flush()

    def close_stdin(self) -> None:
        """End its stdin."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()

    def wait(self, seconds: float | None = None) -> int | None:
        """Wait for its end, at most this many seconds; return its exit code, or None if it still runs."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self._process.wait(seconds)
        return None

    def describe_end(self) -> str:
        """Describe how it ended, with the last line of its log."""
        code = self._process.wait()
        how = f"ended by signal {-code}" if code < 0 else f"ended with exit code {code}"
        if self._log is None:
            return how
        with self._log.open("rb") as file:
            file.seek(max(self._log_start, self._log.stat().st_size - LOG_TAIL_BYTES))
            lines = file.read().decode("utf-8", "replace").strip().splitlines()
        return f"{how}; its last words: {lines[-1][:300]}" if lines else how

    def kill(self) -> int:
        """Kill it, and return its exit code."""
        self._process.kill()
        code = self._process.wait()
        self._listener.join(MAX_LISTENER_WAIT_S)
        self.close_stdin()
        return code

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()


def end_with_parent(signum: int) -> None:
    """Send this process a signal when its stdin ends, which happens when the process of its `Child` ends."""

    def wait() -> None:
        # Not through sys.stdin, whose lock, held while reading, would stay locked in forked processes.
        while os.read(0, 1):
            pass
        os.kill(os.getpid(), signum)

    threading.Thread(target=wait, daemon=True).start()


def process_memory_limit(given: int | None, processes: int) -> float:
    """Return `given`, or if it's None each process's share of nine tenths of the machine's memory, in bytes."""
    return 0.9 * float(psutil.virtual_memory().total) / processes if given is None else float(given)
