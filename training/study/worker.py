"""`python -m hulldown.training.study.worker STUDY NAME`: one run of a study, with progress as JSON lines on stdout."""

from __future__ import annotations

import argparse
import json
import os
import sys
import threading
from pathlib import Path

from hulldown.geometry.errors import HulldownError
from hulldown.training.study.runs import RunOptions, run_one


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m hulldown.training.study.worker", description=__doc__)
    parser.add_argument("study", type=Path)
    parser.add_argument("name")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--workers", type=int)
    arguments = parser.parse_args()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from hulldown.training.extra import require_extra

    try:
        require_extra()
        run_one(arguments.study, arguments.name, RunOptions(arguments.device, arguments.workers), _tell)
    except HulldownError as error:
        print(json.dumps({"failed": str(error)}), flush=True)
        return 1
    return 0


def _tell(what: str, done: int, total: int) -> None:
    print(json.dumps({"what": what, "done": done, "total": total}), flush=True)


def _end_with_parent() -> None:
    """End this process when stdin ends, which happens when the parent ends, even by kill -9."""
    # Not through sys.stdin, whose lock, held while reading, would stay locked in forked processes.
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
