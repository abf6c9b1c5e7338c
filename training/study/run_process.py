"""Do a run of a study in its own process: train and predict.

`python -m hulldown.training.study.run_process STUDY NAME DEVICE [WORKERS]`, with progress as JSON lines on stdout.
"""

from __future__ import annotations

import json
import signal
import sys
from functools import partial
from pathlib import Path

import msgspec

from hulldown.base.child import end_with_parent
from hulldown.base.errors import HulldownError
from hulldown.training.inputs.extra import require_extra
from hulldown.training.study.manifest import (
    RUNS_NAME,
    predictions_paths,
    read_manifest,
)
from hulldown.training.study.runs import Progress, RunMessage, RunOptions


def run_one(study: Path, name: str, options: RunOptions, progress: Progress) -> None:
    """Train the run with this name in study.json, and predict on the test and validation pictures.

    An interrupted run continues. `progress` is called with (title, steps done, all).
    """
    from hulldown.training.predict import predict_detections
    from hulldown.training.train import train_detector

    manifest = read_manifest(study)
    run = manifest.run(name)
    folder = study / RUNS_NAME / run.folder
    train_detector(
        {source: manifest.datasets[source].folder for source in run.sources}, folder, settings=run.settings,
        draws=manifest.draws(run), workers=options.workers, device=options.device, progress=progress,
    )  # fmt: skip
    for which, found in predictions_paths(study, manifest, run).items():
        if not found.exists():
            looking = partial(progress, f"looking at {which}")
            predict_detections(folder, manifest.datasets[which].folder, found, device=options.device, progress=looking)


def _run(study: str, name: str, device: str, *workers: str) -> int:
    """Do a run in this process; return the exit code."""
    end_with_parent(getattr(signal, "SIGKILL", signal.SIGTERM))  # Windows has no SIGKILL
    try:
        require_extra()
        run_one(Path(study), name, RunOptions(device, int(workers[0]) if workers else None), _progress)
    except HulldownError as error:
        _tell(RunMessage(failed=str(error)))
        return 1
    return 0


def _progress(what: str, done: int, total: int) -> None:
    _tell(RunMessage(what=what, done=done, total=total))


def _tell(message: RunMessage) -> None:
    print(json.dumps(msgspec.to_builtins(message)), flush=True)


if __name__ == "__main__":
    sys.exit(_run(*sys.argv[1:]))
