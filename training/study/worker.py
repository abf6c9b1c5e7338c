"""`python -m hulldown.training.study.worker STUDY NAME DEVICE [WORKERS]`: one run of a study.

Its progress is JSON lines on stdout.
"""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

from hulldown.geometry.child import end_with_parent
from hulldown.geometry.errors import HulldownError
from hulldown.training.extra import require_extra
from hulldown.training.study.runs import RunOptions, run_one


def main(study: str, name: str, device: str, *workers: str) -> int:
    """Do the run; return the exit code."""
    end_with_parent(signal.SIGKILL)
    try:
        require_extra()
        run_one(Path(study), name, RunOptions(device, int(workers[0]) if workers else None), _tell)
    except HulldownError as error:
        print(json.dumps({"failed": str(error)}), flush=True)
        return 1
    return 0


def _tell(what: str, done: int, total: int) -> None:
    print(json.dumps({"what": what, "done": done, "total": total}), flush=True)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
