"""A process that renders: a `geometry.child.Child` that is told jobs and answers as JSON."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hulldown.geometry.child import Child
from hulldown.render.blender.worker import ANSWER
from hulldown.render.confinement import Confinement

WORKER = Path(__file__).with_name("blender") / "worker.py"
STOP_S = 5.0  # what a worker gets to end by itself
# For glibc: from how many bytes on a block goes back to the system when it is freed. This is its own first value; left
# alone it raises it to the largest block yet, and other HDRIs and vehicles leave holes: 100 MB more, 7 % growth.
STEADY_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**17)}


def worker_command(blender: str | None) -> list[str]:
    """How to start a worker: in this Python, which has the bpy module, or in an installed Blender."""
    if blender is None:
        return [sys.executable, "-P", str(WORKER)]
    options = ["--background", "--factory-startup", "--disable-autoexec", "--python-exit-code", "1"]
    return [blender, *options, "--python", str(WORKER)]


class WorkerProcess(Child):
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
        log.parent.mkdir(parents=True, exist_ok=True)
        if log.is_symlink():
            log.unlink()

        def answer(line: bytes) -> None:
            text = line.decode("utf-8", "replace")
            if not line:
                hear(self, None)
            elif text.startswith(ANSWER):
                with contextlib.suppress(json.JSONDecodeError):  # half a line of a worker that was killed
                    hear(self, json.loads(text[len(ANSWER) :]))

        super().__init__(
            list(command) if confinement is None else confinement.of(command),
            env={**STEADY_MEMORY, **os.environ, **(confinement.environment if confinement else {})},
            hear=answer,
            log=log,
        )

    def send(self, message: Mapping[str, Any]) -> None:
        """Give it a job."""
        self.write(json.dumps(message).encode() + b"\n")

    def stop(self) -> None:
        """Let it end by itself, if it is idle."""
        self.close_stdin()
        self.wait(STOP_S)
        self.kill()
