"""The runs of a study on the workers of a cluster, which see the study's folder and its datasets as this machine does.

A run is a task. A lost worker costs its run what was trained since its last checkpoint: another worker continues.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from filelock import FileLock, Timeout

from geometry.code import code_sha256
from training.run_folder import LOCK_NAME
from training.study.manifest import MANIFEST_NAME, RUNS_NAME, read_manifest
from training.study.runs import Launch, Options, Progress, in_a_process

RESOURCE = "train"  # what `dask worker --resources "train=1"` declares
CODE = ("training.study.worker",)  # what must be the same on all machines, with all that it imports
POLL_S = 0.2
LOSSES = 3  # of workers over one run, until it is set aside
LEFT_S = 60.0  # what a run gets to end whose worker is gone, until another continues it
# Dask's nanny sets these to 1 for tasks that share a process. A run has its own, and its weights depend on them.
NANNYS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PACKAGES = ("torch", "rfdetr", "pytorch-lightning")


@runtime_checkable
class Workers(Protocol):
    """Workers of a cluster: `render.cluster.Cluster`."""

    @property
    def fit(self) -> frozenset[str]:
        """Addresses of those that get tasks."""
        ...

    def look(self) -> bool:
        """Find workers that came or went; whether the cluster is in reach."""
        ...

    def refuse(self, address: str, why: str) -> None:
        """Give a worker no more tasks."""
        ...

    def submit(self, function: Callable[..., Any], *data: Any) -> Any:
        """Have one of them call a function; a future."""
        ...

    def cancel(self, futures: list[Any]) -> None:
        """Take tasks back."""
        ...


@dataclass(frozen=True, slots=True)
class Order:
    """A run for a worker, and the SHA-256 of the manifest that it must see."""

    study: str
    manifest: str
    name: str
    options: Options


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of a run: `refused` is why its worker can run nothing, `failed` why the run has failed."""

    refused: str = ""
    failed: str | None = None


def launch_on(workers: Workers, function: Callable[[Order], tuple[str, Answer]]) -> Launch:
    """What runs each run on a worker of a cluster, no more at a time than there are workers.

    Parameters
    ----------
    workers
        The cluster's.
    function
        What a worker calls, which comes to `run_here`; returns the worker's address too.
    """
    lock = threading.Lock()
    running: set[str] = set()

    def begin(name: str, order: Order) -> Any:
        with lock:
            if not workers.look() or len(running) >= len(workers.fit):
                return None
            running.add(name)
        return workers.submit(function, order)

    def launch(study: Path, name: str, options: Options, progress: Progress, stop: threading.Event) -> str | None:
        study = study.resolve()
        order = Order(str(study), _sha256(study / MANIFEST_NAME), name, options)
        losses = 0
        while losses < LOSSES:
            while (task := begin(name, order)) is None:
                if stop.wait(POLL_S):
                    return "stopped"
            try:
                while not task.done():
                    if stop.wait(POLL_S):
                        workers.cancel([task])
                        return "stopped"
                    workers.look()
                worker, answer = task.result()
            except CancelledError:
                losses += 1
                continue
            finally:
                with lock:
                    running.discard(name)
            if not answer.refused:
                return answer.failed
            workers.refuse(worker, answer.refused)
        return f"{LOSSES} workers were lost over it"

    return launch


def refusal(client: str) -> str:
    """Why this process can't run the runs of a client with the code `client`; empty if it can."""
    return "" if code() == client else f"has {code()}, and the client {client}"


def run_here(order: Order, wanted: Callable[[], bool]) -> Answer:
    """Run what a client has ordered, in a process of its own.

    Parameters
    ----------
    order
        The run.
    wanted
        Asked now and then whether the client still waits for it; the run is ended if not.
    """
    if wrong := _difference(order):
        return Answer(refused=wrong)
    study = Path(order.study)
    stop, ended = threading.Event(), threading.Event()

    def watch() -> None:
        while not ended.wait(POLL_S):
            if not wanted():
                stop.set()
                return

    threading.Thread(target=watch, daemon=True).start()
    environment = {key: value for key, value in os.environ.items() if not (key in NANNYS and value == "1")}
    try:
        _wait_for(study / RUNS_NAME / read_manifest(study).run(order.name).folder, wanted)
        failed = in_a_process(study, order.name, order.options, _unseen, stop, environment)
    finally:
        ended.set()
    return Answer(failed=failed)


def _difference(order: Order) -> str:
    """Why this machine can't run a run; empty if it can."""
    study = Path(order.study)
    try:
        if _sha256(study / MANIFEST_NAME) != order.manifest:
            return f"sees another study in {study}"
        lost = [data.folder for data in read_manifest(study).datasets.values() if not Path(data.folder).is_dir()]
    except OSError:
        lost = [order.study]
    return f"does not see {lost[0]}, which all machines must share" if lost else ""


def _wait_for(run: Path, wanted: Callable[[], bool]) -> None:
    """Give a process that is still in a run's folder, as its worker is gone, the time to end."""
    lock = run / LOCK_NAME
    waited = 0.0
    while lock.exists() and wanted() and waited < LEFT_S:
        try:
            with FileLock(lock, timeout=POLL_S):
                return
        except Timeout:
            waited += POLL_S


def _unseen(what: str, done: int, total: int) -> None:
    """Progress that nobody sees."""


@cache
def code() -> str:
    """What this process trains with, in words; equal where equal trainings can be expected."""
    found = [f"hulldown {importlib.metadata.version('hulldown')} ({code_sha256(*CODE)[:8]})"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {importlib.metadata.version(package).split('+')[0]}")
        except importlib.metadata.PackageNotFoundError:
            found.append(f"no {package}")
    return ", ".join(found)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
