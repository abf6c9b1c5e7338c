"""Runs of a study on a cluster's workers, which see the study's folder and datasets under the same paths.

Each run is a task. After a lost worker, another one continues from the last checkpoint.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from hulldown.training.run_folder import LOCK_NAME
from hulldown.training.study.manifest import MANIFEST_NAME, RUNS_NAME, read_manifest
from hulldown.training.study.runs import Launch, Progress, RunOptions, in_a_process

RESOURCE = "train"  # what `dask worker --resources "train=1"` declares
LOST = "its workers were lost"
LEFT_S = 60.0  # what a run gets to end whose worker is gone, until another continues it
# Dask's nanny sets these to 1 for tasks that share a process. A run has its own, and its weights depend on them.
NANNYS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PACKAGES = ("torch", "rfdetr", "pytorch-lightning")  # of which all machines must have the same


@dataclass(frozen=True, slots=True)
class TrainingOrder:
    """A run for a worker, and the SHA-256 of the study's manifest."""

    study: str
    manifest: str
    name: str
    options: RunOptions


def launch_on(cluster: Any, function: Callable[[TrainingOrder], Any]) -> Launch:
    """Return a function that runs runs on the workers of a cluster.

    Parameters
    ----------
    cluster
        A `render.cluster.workers.Cluster`.
    function
        The function that a worker calls, which calls `run_here`.
    """

    def launch(
        study: Path, names: Sequence[str], options: RunOptions, progress: Progress
    ) -> Generator[tuple[str, str | None]]:
        study = study.resolve()
        manifest = _sha256(study / MANIFEST_NAME)

        def order(name: str) -> TrainingOrder:
            return TrainingOrder(str(study), manifest, name, options)

        with closing(cluster.run(names, function, order, lost=LOST)) as ended:
            for name, reasons in ended:
                yield name, reasons[-1]

    return launch


def run_here(order: TrainingOrder, wanted: Callable[[], bool]) -> str | None:
    """Run a client's order in a separate process; return the reason of a failure, or None.

    Parameters
    ----------
    order
        The run.
    wanted
        Whether the client still waits for it; if not, the run is ended.
    """
    study = Path(order.study)
    environment = {key: value for key, value in os.environ.items() if not (key in NANNYS and value == "1")}
    lock = study / RUNS_NAME / read_manifest(study).run(order.name).folder / LOCK_NAME
    if lock.exists():  # a lost worker's process may still run
        with suppress(Timeout), FileLock(lock, timeout=LEFT_S):
            pass
    return in_a_process(
        study, order.name, order.options, lambda what, done, total: None, lambda: not wanted(), environment
    )


def unseen(order: TrainingOrder) -> str:
    """Reason why this machine can't do a run, such as unseen files; empty if it can."""
    study = Path(order.study)
    try:
        if _sha256(study / MANIFEST_NAME) != order.manifest:
            return f"sees another study in {study}"
        lost = [data.folder for data in read_manifest(study).datasets.values() if not Path(data.folder).is_dir()]
    except OSError:
        lost = [order.study]
    return f"does not see {lost[0]}, which all machines must share" if lost else ""


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
