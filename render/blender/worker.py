"""The child process with Blender: reads pickled jobs on stdin, and writes replies as JSON lines to its original stdout.

Started as `python -P render/blender/worker.py` where bpy is a module, or by an installed Blender with `--python`;
Blender stays on the main thread. Needs numpy and bpy only. Everything else that is printed here, Blender's own messages
included, goes to stderr, which the supervisor keeps as a log.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import pickle
import platform
import queue
import signal
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from hulldown.render.blender.messages import Job

MIN_BLENDER_VERSION = (5, 0)  # older ones keep compositor and world nodes elsewhere


def main() -> int:
    """Do jobs until stdin ends."""
    _make_hulldown_importable()
    replies = _claim_stdout()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the supervisor's; it closes our stdin
    jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
    threading.Thread(target=_queue_jobs_from_stdin, args=(jobs,), daemon=True).start()
    import bpy  # takes a second, and its messages belong in the log

    from hulldown.render.blender.reply import REPLY_PREFIX, Reply

    def reply(message: Reply) -> None:
        replies.write(REPLY_PREFIX + json.dumps(vars(message)) + "\n")
        replies.flush()

    if bpy.app.version < MIN_BLENDER_VERSION:
        wanted = ".".join(map(str, MIN_BLENDER_VERSION))
        reply(Reply(unusable=f"it is Blender {bpy.app.version_string}", remedy=f"use version {wanted} or later"))
        return 1
    try:
        import numpy as np

        from hulldown.render.blender.cycles import Unusable
        from hulldown.render.blender.renderer import Renderer
    except ModuleNotFoundError as error:
        python = f"the Python {platform.python_version()} of Blender {bpy.app.version_string}"
        remedy = f"install {error.name} for that Python"
        reply(Reply(unusable=f"{python} has no {error.name}", remedy=remedy))
        return 1
    renderer = Renderer()
    versions = f"{bpy.app.version_string}, Python {platform.python_version()}, NumPy {np.__version__}"
    reply(Reply(ready=versions))
    while (job := jobs.get()) is not None:
        try:
            message = renderer.do(job)
        except Unusable as error:
            problem, remedy = error.args
            message = Reply(unusable=problem, remedy=remedy)
        except Exception as error:
            traceback.print_exc()
            message = Reply(failed=f"{type(error).__name__}: {error}")
            renderer.forget_assets()
        reply(message)
    return 0


def _make_hulldown_importable() -> None:
    """Make `hulldown` importable in any Python, but not this folder, whose cycles.py would hide Blender's."""
    here = Path(__file__).resolve().parent
    sys.path[:] = [entry for entry in sys.path if Path(entry or ".").resolve() != here]
    root = here.parents[1]
    spec = importlib.util.spec_from_file_location("hulldown", root / "__init__.py", submodule_search_locations=[str(root)])
    assert spec is not None
    assert spec.loader is not None
    sys.modules["hulldown"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules["hulldown"])


def _claim_stdout() -> TextIO:
    """Return a stream to the supervisor; file descriptor 1 is redirected to the log, for C code that prints."""
    stream = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return stream


def _queue_jobs_from_stdin(jobs: queue.SimpleQueue[Job | None]) -> None:
    """Queue jobs; end at once, even during a picture, when the supervisor is gone."""
    try:
        with contextlib.suppress(EOFError, pickle.UnpicklingError):  # the end, perhaps in the middle of a job
            while True:
                jobs.put(pickle.load(sys.stdin.buffer))
    finally:  # also after a job of another version of hulldown
        jobs.put(None)
        time.sleep(1.0)  # an idle worker has ended by itself by now
        os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
