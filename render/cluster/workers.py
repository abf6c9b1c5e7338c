"""Run tasks on the workers of a Dask cluster, for images and trainings alike.

Dask schedules tasks, reassigns those of a lost worker, and moves data. This module excludes workers that can't
do the tasks.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, TypeVar
from weakref import WeakValueDictionary

from distributed import Client, Future, KilledWorker, Security, get_worker
from distributed.comm import CommClosedError
from distributed.worker import thread_state

from hulldown.geometry.errors import HulldownError
from hulldown.render.cluster.scheduler import Scheduler

GONE_S = 15.0  # longest time without a scheduler
LOOK_S = 1.0  # interval of the client's checks for workers
POLL_S = 0.05
GATHER_S = 60.0  # for a result over the network, before it's requested again
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
    refused
        Reason why this worker can't do any task; empty if it can.
    lines
        Messages for the user.
    worker
        Address of the worker.
    """

    value: Any = None
    has_failed: bool = False
    lacking: tuple[str, ...] = ()
    refused: str = ""
    lines: tuple[str, ...] = ()
    worker: str = field(default_factory=lambda: str(get_worker().address))


@dataclass(eq=False, slots=True)
class _Task(Generic[Job]):
    """An unfinished job.

    Parameters
    ----------
    job
        The caller's job.
    failed_on
        Workers that failed at it.
    contents
        Data for its next worker.
    losses
        Number of workers lost during it.
    is_suspect
        Whether it's tried alone, since it may crash workers.
    """

    job: Job
    failed_on: list[str] = field(default_factory=list)
    contents: list[Future] = field(default_factory=list)
    losses: int = 0
    is_suspect: bool = False


class Cluster:
    """A connection to a cluster's workers, for any thread. Leaving it as a context cancels its tasks.

    Parameters
    ----------
    scheduler
        The cluster's.
    resource
        A resource that each task needs: ``dask worker --resources "NAME=1"``.
    refusal
        Called on each new worker with `about`; returns the reason why it can't do tasks, empty if it can.
    about
        The client's data for `refusal`.
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
        refusal: Callable[..., str],
        about: tuple[Any, ...],
        *,
        at_once: int = 1,
        say: Callable[[str], None],
    ) -> None:
        self._address, self._resource, self._at_once, self._say = scheduler.address, resource, at_once, say
        self._refusal, self._about = refusal, about
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # this module reports problems itself
        self.client = _connect(scheduler)
        self._lock = threading.RLock()
        self._reached, self._looked = time.monotonic(), 0.0
        self._fit: set[str] = set()
        self._refused: dict[str, str] = {}
        self._asked: dict[str, Future] = {}
        self._told = -1
        self._strikes: dict[str, int] = {}
        self._tasks: dict[Future, frozenset[str]] = {}  # allowed workers of each
        self._contents: WeakValueDictionary[str, Future] = WeakValueDictionary()
        if "dashboard" in self.client.scheduler_info()["services"]:
            self._say(f"dashboard: {self.client.dashboard_link}")

    @property
    def fit(self) -> frozenset[str]:
        """Addresses of accepted workers."""
        return frozenset(self._fit)

    def results(
        self,
        jobs: Iterable[Job],
        function: Callable[..., Answer],
        order: Callable[[Job], Any],
        *,
        stopping: Callable[[], bool],
        content: Callable[[str], bytes] = lambda digest: b"",
    ) -> Iterator[tuple[Job, Answer | None]]:
        """Run jobs on the workers; yields each with its answer when it ends, None if its workers were lost.

        Parameters
        ----------
        jobs
            Any objects.
        function
            Called on a worker with an order, and contents that it lacked; returns an `Answer`.
        order
            Function from a job to its order.
        stopping
            Called several times a second; true: end early.
        content
            Function from a SHA-256 to its data.

        Raises
        ------
        HulldownError
            If the scheduler is lost, or there are workers and all are refused.
        """
        new = map(_Task, jobs)  # lazily, for any number of jobs
        waiting, suspects = deque(islice(new, 1)), deque[_Task[Job]]()
        running: dict[Future, _Task[Job]] = {}
        try:
            while (waiting or suspects or running) and not stopping():
                with self._lock:
                    is_connected = self.look()
                    while is_connected and waiting and len(self._tasks) < self._at_once * len(self._fit):
                        task = waiting.popleft()
                        running[self._submit(function, order(task.job), task)] = task
                        if not waiting:
                            waiting.extend(islice(new, 1))
                    if is_connected and self._fit and suspects and not self._tasks and not waiting:
                        task = suspects.popleft()
                        running[self._submit(function, order(task.job), task)] = task
                ended = [future for future in running if future.done()]
                for future in ended:
                    task = running.pop(future)
                    answer: Answer | None = None
                    try:
                        answer = future.result(timeout=GATHER_S)
                    except TimeoutError:
                        running[future] = task
                        continue
                    except CancelledError:  # its workers, contents, or scheduler are gone
                        task.losses += 1
                    except KilledWorker:  # Dask has tried it on several workers
                        task.losses = LOSSES
                    self._tasks.pop(future, None)
                    task.contents = []
                    if answer is None and task.losses < LOSSES and not task.is_suspect:
                        waiting.appendleft(task)
                    elif answer is None and not task.is_suspect:
                        task.is_suspect = True
                        suspects.append(task)
                    elif answer is None or self._is_final(answer, task, content):
                        yield task.job, answer
                    else:
                        waiting.appendleft(task)
                if not ended:
                    time.sleep(POLL_S)
        finally:
            self.cancel(running)

    def _submit(self, function: Callable[..., Answer], order: Any, task: _Task[Any]) -> Future:
        workers = self.fit - set(task.failed_on) or self.fit
        future = self.client.submit(
            function,
            order,
            *task.contents,
            key=f"hulldown-{uuid.uuid4().hex}",
            workers=sorted(workers),
            allow_other_workers=False,
            resources={self._resource: 1},
            pure=False,
        )
        self._tasks[future] = workers
        return future

    def _is_final(self, answer: Answer, task: _Task[Any], content: Callable[[str], bytes]) -> bool:
        """Whether a task is done; otherwise prepare its next attempt."""
        with self._lock:
            for line in answer.lines:
                self._say(f"{answer.worker}: {line}")
            if answer.refused:
                self.refuse(answer.worker, answer.refused)
                return False
            if answer.lacking:
                futures = (self._content(digest, content, answer.worker) for digest in answer.lacking)
                task.contents = [future for future in futures if future is not None]
                return False
            if answer.has_failed:
                task.failed_on.append(answer.worker)
                return len(task.failed_on) > 1 or not self._fit - {answer.worker}
            for address in task.failed_on:
                self._strikes[address] = self._strikes.get(address, 0) + 1
                if self._strikes[address] == STRIKES:
                    self.refuse(address, f"has failed at {STRIKES} images that others could render")
            return True

    def _content(self, digest: str, read: Callable[[str], bytes], worker: str) -> Future | None:
        """A future of data in the cluster's memory, stored on a worker first; None if that worker is gone."""
        future = self._contents.get(digest)
        if future is None or future.status in ("cancelled", "lost", "error"):
            key, data = f"hulldown-{digest}", read(digest)
            try:
                future = self.client.scatter({key: data}, workers=[worker])[key]
            except (OSError, ValueError, KeyError, TimeoutError):
                return None
            self._contents[digest] = future
        return future

    def look(self) -> bool:
        """Update the list of workers; return whether the scheduler can be reached.

        Raises
        ------
        HulldownError
            If the scheduler is lost, or there are workers and all are refused.
        """
        with self._lock:
            if not self._is_connected():
                return False
            if time.monotonic() > self._looked + LOOK_S:
                self._looked = time.monotonic()
                with contextlib.suppress(OSError):
                    self._count(self._workers())
            if self._asked and self._asked.keys() == self._refused.keys():
                address = next(reversed(self._refused))
                raise HulldownError(f"is refused, as all workers are: it {self._refused[address]}", path=address)
            return True

    def _is_connected(self) -> bool:
        now = time.monotonic()
        if self.client.status == "running":
            self._reached = now
            return True
        if self.client.status == "closed" or now > self._reached + GONE_S:
            raise HulldownError(
                "the scheduler is out of reach",
                path=self._address,
                remedy="start one, and run the same command with its address, which continues",
            )
        return False

    def _workers(self) -> set[str]:
        # Client.scheduler_info() is replaced every other second by an answer without workers.
        workers = self.client.sync(self.client.scheduler.identity, n_workers=-1)["workers"]
        return {address for address, about in workers.items() if about["resources"].get(self._resource, 0) >= 1}

    def _count(self, there: set[str]) -> None:
        for address in self._fit - there:
            self._say(f"{address}: is gone; others do its tasks")
        self._fit &= there
        self._refused = {address: why for address, why in self._refused.items() if address in there}
        self._asked = {
            address: self._asked.get(address)
            or self.client.submit(self._refusal, *self._about, workers=[address], priority=1, pure=False)
            for address in there
        }
        for address in there - self._fit - self._refused.keys():
            if self._asked[address].done():
                self._judge(address, self._asked[address])
        if len(self._fit) != self._told and (self._fit or self._asked.keys() == self._refused.keys()):
            self._told = len(self._fit)
            many = f"{self._told} workers are in use"
            self._say({0: "waiting for workers", 1: "1 worker is in use"}.get(self._told, many))
        # Dask would wait for one of the task's lost workers.
        self.cancel([task for task, workers in self._tasks.items() if not workers & there and not task.done()])

    def _judge(self, address: str, asked: Future) -> None:
        error = CancelledError() if asked.cancelled() else asked.exception()
        if isinstance(error, OSError | CommClosedError | CancelledError | KilledWorker):
            del self._asked[address]  # it's gone, or will be asked again
        elif why := f"fails: {type(error).__name__}: {error}" if error else asked.result():
            self.refuse(address, why)
        else:
            self._fit.add(address)

    def refuse(self, address: str, why: str) -> None:
        """Exclude a worker; `why` completes a sentence about it."""
        with self._lock:
            if address not in self._refused:
                self._refused[address] = why
                self._say(f"{address}: is not used: it {why}")
            self._fit.discard(address)

    def cancel(self, futures: Iterable[Future]) -> None:
        """Cancel tasks; a running one notices by `wanted`."""
        with self._lock:
            for future in (futures := list(futures)):
                self._tasks.pop(future, None)
            if futures and self.client.status == "running":
                self.client.cancel(futures, force=True)

    def __enter__(self) -> Cluster:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.client.close(timeout=5)


def wanted() -> Callable[[], bool]:
    """Return a function that tells, in any thread, whether the client still wants the current task."""
    worker, key = get_worker(), thread_state.key

    def ask() -> bool:
        state = worker.state.tasks.get(key)
        return state is not None and state.state == "executing"

    return ask


def _connect(scheduler: Scheduler) -> Client:
    files = {
        "tls_ca_file": scheduler.tls_ca,
        "tls_client_cert": scheduler.tls_cert,
        "tls_client_key": scheduler.tls_key,
    }
    given = {key: str(path) for key, path in files.items() if path is not None}
    security = Security(require_encryption=True, **given) if given else None
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
