"""The runs of a study on the workers of a cluster, which see the study's folder and its datasets as this machine does.

A run is a task. A worker that is lost costs its run what it has trained since its last checkpoint: another goes on.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import queue
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, runtime_checkable

from filelock import FileLock, Timeout
from pydantic import BaseModel, ConfigDict

from geometry.errors import HulldownError
from training.run_folder import LOCK_NAME
from training.study.manifest import MANIFEST_NAME, RUNS_NAME, read_manifest
from training.study.runs import Options, Progress, in_a_process

RESOURCE = "train"  # what `dask worker --resources "train=1"` says that a worker may do
POLL_S = 0.2
LOSSES = 3  # of workers over one run, until it is set aside
LEFT_S = 60.0  # what a run gets to end whose worker is gone, until another goes on with it
# Dask's nanny sets these to 1 for tasks that share a process; a run has one of its own, and its weights differ by them.
NANNYS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PACKAGES = ("torch", "rfdetr", "pytorch-lightning")


@runtime_checkable
class Workers(Protocol):
    """What hands out tasks: `render.tasks.Tasks`."""

    @property
    def events(self) -> queue.SimpleQueue[tuple[Any, bytes | BaseException]]:
        """Tasks that have ended, each with its result, or with why there is none."""
        ...

    def workers(self) -> dict[str, bool] | None:
        """Which there are, and whether they take tasks; None for no news."""
        ...

    def submit(self, worker: str, function: Callable[..., bytes], *data: bytes) -> Any:
        """Have a worker call a function; the task."""
        ...

    def take_back(self, tasks: Sequence[Any]) -> None:
        """Forget tasks."""
        ...

    def failed(self, task: Any) -> bool:
        """Whether a task that has ended without a result has failed by itself."""
        ...


class Order(BaseModel):
    """A run that a worker shall run: `code` and `manifest` say what must be the same there."""

    model_config = ConfigDict(frozen=True)

    code: str
    study: str
    manifest: str
    name: str
    device: str
    workers: int | None


class Answer(BaseModel):
    """What became of it: `refused` is why the worker can run nothing, `failed` why this run has failed."""

    model_config = ConfigDict(frozen=True)

    refused: str = ""
    failed: str | None = None


@dataclass(eq=False, slots=True)
class _Asked:
    """A run that somebody waits for."""

    order: Order
    reply: queue.SimpleQueue[str | None] = field(default_factory=queue.SimpleQueue)
    lost: list[str] = field(default_factory=list)


class OnWorkers:
    """A `training.study.runs.Launch` that runs each run on a worker of a cluster. Leaving it as a context ends those.

    Parameters
    ----------
    workers
        The cluster's.
    function
        What a worker calls with an encoded `Order`; it comes to `run_here`.
    say
        Told a line now and then.
    """

    def __init__(self, workers: Workers, function: Callable[[bytes], bytes], say: Callable[[str], None]) -> None:
        self._workers, self._function, self._say = workers, function, say
        self._asked: queue.SimpleQueue[_Asked] = queue.SimpleQueue()
        self._waiting: deque[_Asked] = deque()
        self._running: dict[str, tuple[Any, _Asked]] = {}  # by worker
        self._refused: dict[str, str] = {}
        self._there: dict[str, bool] = {}
        self._told = -1
        self._error: Exception | None = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __call__(
        self, study: Path, name: str, options: Options, progress: Progress, stop: threading.Event
    ) -> str | None:
        """Run a run; why it failed, None if it did not."""
        study = study.resolve()
        manifest = _digest(study / MANIFEST_NAME)
        order = Order(
            code=code(), study=str(study), manifest=manifest, name=name, device=options.device, workers=options.workers
        )
        asked = _Asked(order)
        self._asked.put(asked)
        while not stop.is_set():
            if self._error is not None:
                raise self._error
            try:
                return asked.reply.get(timeout=POLL_S)
            except queue.Empty:
                continue
        return "stopped"

    def _serve(self) -> None:
        try:
            while not self._closed.is_set():
                while not self._asked.empty():
                    self._waiting.append(self._asked.get())
                if (there := self._workers.workers()) is not None:
                    self._look(there)
                self._start()
                try:
                    task, outcome = self._workers.events.get(timeout=POLL_S)
                except queue.Empty:
                    continue
                if self._is_running(task):  # and was not taken away from its worker
                    self._hear(task, self._running.pop(task.worker)[1], outcome)
        except Exception as error:  # raised where somebody waits
            self._error = error

    def _is_running(self, task: Any) -> bool:
        return task.worker in self._running and self._running[task.worker][0] is task

    def _look(self, there: dict[str, bool]) -> None:
        self._there = there
        for worker in self._running.keys() - there.keys():
            task, asked = self._running.pop(worker)
            self._workers.take_back([task])
            self._lose(asked, f"{worker} was lost")
        usable = sum(is_open and worker not in self._refused for worker, is_open in there.items())
        if usable != self._told:
            self._told = usable
            self._say({0: "waiting for workers", 1: "1 worker trains"}.get(usable, f"{usable} workers train"))
        if there and there.keys() <= self._refused.keys():
            worker = next(reversed(self._refused))
            raise HulldownError(f"is refused as all workers are: it {self._refused[worker]}", path=worker)

    def _start(self) -> None:
        for worker, is_open in self._there.items():
            if self._waiting and is_open and worker not in self._refused and worker not in self._running:
                asked = self._waiting.popleft()
                order = asked.order.model_dump_json().encode()
                self._running[worker] = self._workers.submit(worker, self._function, order), asked
                self._say(f"{asked.order.name}: begins on {worker}")

    def _hear(self, task: Any, asked: _Asked, outcome: bytes | BaseException) -> None:
        if isinstance(outcome, BaseException):
            if not self._workers.failed(task):
                self._waiting.appendleft(asked)
            else:
                self._lose(asked, f"{type(outcome).__name__}: {outcome}")
            return
        answer = Answer.model_validate_json(outcome)
        if answer.refused:
            self._refused[task.worker] = answer.refused
            self._say(f"{task.worker}: gets no runs: it {answer.refused}")
            self._waiting.appendleft(asked)
        else:
            asked.reply.put(answer.failed)

    def _lose(self, asked: _Asked, why: str) -> None:
        asked.lost.append(why)
        if len(asked.lost) >= LOSSES:
            asked.reply.put(f"{LOSSES} workers could not run it: {why}")
        else:
            self._say(f"{asked.order.name}: {why}; another goes on")
            self._waiting.appendleft(asked)

    def __enter__(self) -> OnWorkers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closed.set()
        self._thread.join()
        self._workers.take_back([task for task, _ in self._running.values()])


def run_here(order: bytes, wanted: Callable[[], bool]) -> bytes:
    """Run what a client has ordered, in a process of its own.

    Parameters
    ----------
    order
        An encoded `Order`.
    wanted
        Asked now and then whether the client still waits for it; the run is ended if not.

    Returns
    -------
    An encoded `Answer`.
    """
    asked = Order.model_validate_json(order)
    if wrong := _difference(asked):
        return Answer(refused=wrong).model_dump_json().encode()
    for variable in NANNYS:
        if os.environ.get(variable) == "1":
            del os.environ[variable]
    study = Path(asked.study)
    stop, ended = threading.Event(), threading.Event()

    def watch() -> None:
        while not ended.wait(POLL_S):
            if not wanted():
                stop.set()
                return

    threading.Thread(target=watch, daemon=True).start()
    try:
        _wait_for(study / RUNS_NAME / read_manifest(study).run(asked.name).folder, wanted)
        failed = in_a_process(study, asked.name, Options(asked.device, asked.workers), _unseen, stop)
    finally:
        ended.set()
    return Answer(failed=failed).model_dump_json().encode()


def _difference(asked: Order) -> str:
    """Why this process cannot run what was asked; empty if it can."""
    if asked.code != code():
        return f"has {code()}, and the client {asked.code}"
    study = Path(asked.study)
    try:
        if _digest(study / MANIFEST_NAME) != asked.manifest:
            return f"sees another study in {study}"
        lost = [data.folder for data in read_manifest(study).datasets.values() if not Path(data.folder).is_dir()]
    except OSError:
        lost = [asked.study]
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
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(root.rglob("*.py")))).hexdigest()
    found = [f"hulldown {importlib.metadata.version('hulldown')} ({digest[:8]})"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {importlib.metadata.version(package).split('+')[0]}")
        except importlib.metadata.PackageNotFoundError:
            found.append(f"no {package}")
    return ", ".join(found)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
