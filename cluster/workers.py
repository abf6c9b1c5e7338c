"""Run tasks on the workers of a Dask cluster, for images and trainings alike.

Dask moves code and data, and reports lost workers. This module chooses a worker for each task, and excludes workers
that can't do the tasks.
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Self, TypeVar
from weakref import WeakValueDictionary

from distributed import Client, Future, KilledWorker, Security, as_completed, get_worker
from distributed.worker import thread_state

from hulldown.base.child import Stopped
from hulldown.base.errors import HulldownError
from hulldown.cluster.scheduler import Scheduler

GONE_S = 15.0  # longest time without a scheduler
LOOK_S = 1.0  # interval of the client's checks for workers
POLL_S = 0.05
LOSSES = 3  # workers lost during a task before it's tried alone
STRIKES = 3  # tasks that only this worker fails at, before it's excluded

Job = TypeVar("Job")


@dataclass(frozen=True, slots=True)
class Answer:
    """A task's answer.

    Parameters
    ----------
    value
        Its result.
    has_failed
        Whether another worker should try it.
    lacking
        SHA-256 of contents that the worker needs first.
    lines
        Messages for the user.
    """

    value: Any = None
    has_failed: bool = False
    lacking: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()


@dataclass(eq=False, slots=True)
class _Task(Generic[Job]):
    """An unfinished job: its last worker, results of workers that failed, how many were lost, and data sent for it."""

    job: Job
    worker: str = ""
    failed: dict[str, Any] = field(default_factory=dict)
    losses: int = 0
    contents: tuple[Future, ...] = ()  # deleted from the cluster's memory with the last of these


class Cluster:
    """A connection to a cluster's workers. Leaving it as a context cancels its tasks.

    Parameters
    ----------
    scheduler
        The cluster's.
    resource
        A resource that each task needs: ``dask worker --resources "NAME=1"``.
    refusal
        Called on a worker before each task; returns the reason why it can't do tasks, empty if it can.
    at_once
        Tasks sent to each worker: a running one, and waiting ones.
    say
        Called with messages for the user.

    Raises
    ------
    HulldownError
        If no scheduler answers.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        resource: str,
        refusal: Callable[[], str],
        *,
        at_once: int = 1,
        say: Callable[[str], None],
    ) -> None:
        self._address, self._resource, self._refusal = scheduler.address, resource, refusal
        self._at_once, self._say = at_once, say
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # this module reports problems itself
        self.client = _connect(scheduler)
        self._looked, self._told = 0.0, -1
        self._there: set[str] = set()  # workers with the resource
        self._refused: dict[str, str] = {}
        self._strikes = Counter[str]()
        self._contents: WeakValueDictionary[str, Future] = WeakValueDictionary()
        if "dashboard" in self.client.scheduler_info()["services"]:
            self._say(f"dashboard: {self.client.dashboard_link}")

    @property
    def working(self) -> int:
        """Number of workers that get tasks."""
        return len(self._fit)

    @property
    def _fit(self) -> set[str]:
        return self._there - self._refused.keys()

    def run(
        self,
        jobs: Iterable[Job],
        call: Callable[[Job], Callable[..., Answer]],
        *,
        lost: Any,
        stopping: Callable[[], bool] = lambda: False,
        content: Callable[[str], bytes] = lambda digest: b"",
    ) -> Generator[tuple[Job, list[Any]]]:
        """Run jobs on the workers; yields each when it ends, with the results of workers that failed, and the last one.

        Parameters
        ----------
        jobs
            Any objects.
        call
            Function from a job to what is called on a worker, with contents that it lacked.
        lost
            The last result of a job during which workers are lost again and again.
        stopping
            Called several times a second; true: stop now.
        content
            Function from a SHA-256 to its data.

        Raises
        ------
        Stopped
            If `stopping` returned true.
        HulldownError
            If the scheduler is lost, or there are workers and all are refused.
        """
        waiting, running = deque(map(_Task, jobs)), dict[Future, _Task[Job]]()
        ended = as_completed(loop=self.client.loop, with_results=True, raise_errors=False)

        def submit(task: _Task[Job], worker: str, *contents: Future) -> None:
            future = self.client.submit(
                _do, self._refusal, pickle.dumps(call(task.job)), *contents,
                workers=[worker], allow_other_workers=False, resources={self._resource: 1}, pure=False,
            )  # fmt: skip
            running[future], task.worker, task.contents = task, worker, contents
            ended.add(future)

        try:
            while waiting or running:
                if stopping():
                    raise Stopped
                is_connected = self._look()
                while is_connected and waiting and (worker := self._place(waiting[0], running.values())):
                    submit(waiting.popleft(), worker)
                gone = [each for each, task in running.items() if task.worker not in self._there or each.cancelled()]
                self._cancel(gone)  # Dask would wait for the lost worker
                batch = [*ended.next_batch(block=False), *((future, CancelledError()) for future in gone)]
                for future, result in batch:
                    if future not in running:
                        continue
                    task = running.pop(future)
                    if isinstance(result, Answer) and result.lacking:
                        submit(task, task.worker, *self._sent(result.lacking, content, task.worker))
                    elif results := self._results(task, result, lost):
                        yield task.job, results
                    elif task.failed or task.losses == LOSSES:
                        waiting.append(task)
                    else:
                        waiting.appendleft(task)
                if not batch:
                    time.sleep(POLL_S)
        finally:
            self._cancel(running)

    def _place(self, task: _Task[Any], running: Iterable[_Task[Any]]) -> str | None:
        """The least busy worker with room for a task, preferably one that hasn't failed at it; None: not yet."""
        load = Counter(each.worker for each in running)
        if load and task.losses == LOSSES:
            return None  # it may crash workers, so it's tried alone
        workers = sorted(self._fit - task.failed.keys() or self._fit)
        return min((each for each in workers if load[each] < self._at_once), key=load.__getitem__, default=None)

    def _results(self, task: _Task[Any], result: Any, lost: Any) -> list[Any]:
        """All results of a task that has ended; empty if it must be tried again."""
        if isinstance(result, tuple):  # of a failed task: type, error, and traceback
            result = result[1]
        if isinstance(result, CancelledError | KilledWorker):  # its worker, contents, or scheduler are gone
            task.losses += 1
            return [*task.failed.values(), lost] if task.losses > LOSSES else []
        if not isinstance(result, Answer):
            kind = "" if isinstance(result, HulldownError | OSError) else f"{type(result).__name__}: "
            self._refuse(task.worker, result if isinstance(result, str) else f"fails: {kind}{result}")
            return []
        for line in result.lines:
            self._say(f"{task.worker}: {line}")
        results = [*task.failed.values(), result.value]
        if result.has_failed:
            task.failed[task.worker] = result.value
            return results if len(task.failed) > 1 or self._fit <= task.failed.keys() else []
        self._strikes.update(task.failed.keys())
        for address in task.failed:
            if self._strikes[address] == STRIKES:
                self._refuse(address, f"has failed at {STRIKES} images that others could render")
        return results

    def _sent(self, digests: Iterable[str], read: Callable[[str], bytes], worker: str) -> Iterator[Future]:
        """Futures of data in the cluster's memory, stored on a worker first; none if that worker is gone."""
        for digest in digests:
            future = self._contents.get(digest)
            if future is None or future.status in ("cancelled", "lost", "error"):
                data = read(digest)
                try:  # without a hash: the release of an earlier future of the same key may come later
                    future = self.client.scatter(data, workers=[worker], hash=False)
                except (OSError, ValueError, KeyError, TimeoutError):
                    continue
                self._contents[digest] = future
            yield future

    def _look(self) -> bool:
        """Update the list of workers; return whether the scheduler can be reached.

        Raises
        ------
        HulldownError
            If the scheduler is lost, or there are workers and all are refused.
        """
        if self.client.status == "closed":  # since it was out of reach for `GONE_S`
            remedy = "start one, and run the same command with its address, which continues"
            raise HulldownError("the scheduler is out of reach", path=self._address, remedy=remedy)
        if self.client.status == "running" and time.monotonic() > self._looked + LOOK_S:
            self._looked = time.monotonic()
            with contextlib.suppress(OSError):
                # Client.scheduler_info() is replaced every other second by an answer without workers.
                workers = self.client.sync(self.client.scheduler.identity, n_workers=-1)["workers"]
                self._count({at for at, about in workers.items() if about["resources"].get(self._resource, 0) >= 1})
        return self.client.status == "running"

    def _count(self, there: set[str]) -> None:
        for address in self._fit - there:
            self._say(f"{address}: is gone; others do its tasks")
        self._there = there
        self._refused = {address: why for address, why in self._refused.items() if address in there}
        if there and not self._fit:
            address = next(reversed(self._refused))
            raise HulldownError(f"is refused, as all workers are: it {self._refused[address]}", path=address)
        if self.working != self._told:
            self._told = self.working
            many = f"{self._told} workers are in use"
            self._say({0: "waiting for workers", 1: "1 worker is in use"}.get(self._told, many))

    def _refuse(self, address: str, why: str) -> None:
        """Exclude a worker; `why` completes a sentence about it."""
        if address not in self._refused:
            self._refused[address] = why
            self._say(f"{address}: is not used: it {why}")

    def _cancel(self, futures: Iterable[Future]) -> None:
        """Cancel tasks; a running one notices by `wanted`."""
        if (futures := list(futures)) and self.client.status == "running":
            self.client.cancel(futures, force=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close(timeout=5)


def _do(refusal: Callable[[], str], job: bytes, *contents: bytes) -> Answer | str:
    """Do a task on a worker, or return the reason why it can't; only the client's own code unpickles the job."""
    if why := refusal():
        return why
    answer: Answer = pickle.loads(job)(*contents)
    return answer


def wanted() -> Callable[[], bool]:
    """Return a function that tells, in any thread, whether the client still wants the current task."""
    worker, key = get_worker(), thread_state.key

    def ask() -> bool:
        state = worker.state.tasks.get(key)
        return state is not None and state.state == "executing"

    return ask


def _connect(scheduler: Scheduler) -> Client:
    security = Security(require_encryption=True, **scheduler.tls) if scheduler.tls else None
    address = scheduler.address
    of_file = address.endswith(".json")
    if of_file and not Path(address).is_file():
        remedy = f"start one with `dask scheduler --scheduler-file {address}`"
        raise HulldownError("there is no such file of a scheduler", path=address, remedy=remedy)
    where = {"scheduler_file": address} if of_file else {"address": address}
    try:
        return Client(**where, security=security, timeout=GONE_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        remedy = "start one with `hulldown cluster`, or see docs/cluster.md"
        raise HulldownError(f"no Dask scheduler answers there ({error})", path=address, remedy=remedy) from None
