"""Runs of a study on a cluster's workers, which see the study's folder and datasets under the same paths.

Each run is a task. After a lost worker, another one continues from the last checkpoint.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from filelock import FileLock, Timeout

from hulldown.training.run_folder import LOCK_NAME
from hulldown.training.study.manifest import MANIFEST_NAME, RUNS_NAME, read_manifest
from hulldown.training.study.runs import RunOptions, in_a_process

RESOURCE = "train"  # what `dask worker --resources "train=1"` declares
LOST = "its workers were lost"
LEFT_S = 60.0  # what a run gets to end whose worker is gone, until another continues it
# Dask's nanny sets these to 1 for tasks that share a process. A run has its own, and its weights depend on them.
NANNYS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PACKAGES = ("torch", "rfdetr", "pytorch-lightning")  # of which all machines must have the same


def run_here(study: Path, name: str, options: RunOptions, wanted: Callable[[], bool]) -> str | None:
    """Do a run for a client in a separate process; return the reason of a failure, or None.

    Parameters
    ----------
    study, name, options
        As of `training.study.runs.run_one`.
    wanted
        Whether the client still waits for it; if not, the run is ended.
    """
    environment = {key: value for key, value in os.environ.items() if not (key in NANNYS and value == "1")}
    lock = study / RUNS_NAME / read_manifest(study).run(name).folder / LOCK_NAME
    if lock.exists():  # a lost worker's process may still run
        with suppress(Timeout), FileLock(lock, timeout=LEFT_S):
            pass
    return in_a_process(study, name, options, lambda what, done, total: None, lambda: not wanted(), environment)


def unseen(study: Path, manifest: str) -> str:
    """Reason why this machine can't do runs of the study with this manifest, such as unseen files; empty if it can."""
    try:
        if manifest_digest(study) != manifest:
            return f"sees another study in {study}"
        lost = [data.folder for data in read_manifest(study).datasets.values() if not Path(data.folder).is_dir()]
    except OSError:
        lost = [str(study)]
    return f"does not see {lost[0]}, which all machines must share" if lost else ""


def manifest_digest(study: Path) -> str:
    """The SHA-256 of a study's manifest."""
    return hashlib.sha256((study / MANIFEST_NAME).read_bytes()).hexdigest()
