"""Run tasks on the workers of a Dask cluster.

Dask places the tasks, moves those of lost workers to others, and gives up a task during which worker after worker is
lost. This module checks each worker before it gets tasks, and excludes and names those that can't do them.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

from distributed import Client, Future, KilledWorker, Security, as_completed, get_worker
from distributed.comm import connect
from distributed.worker import thread_state

from hulldown.base.child import Stopped
from hulldown.base.errors import HulldownError
from hulldown.cluster.scheduler import Scheduler

MAX_SCHEDULER_ABSENCE_S = 15.0
WORKER_CHECK_INTERVAL_S = 1.0
POLL_S = 0.05
MAX_TASK_RETRIES = 2  # after errors that nobody foresaw
MAX_TASK_LOSSES = 3  # a task that has lost all its workers this often is tried alone
MAX_WORKER_STRIKES = 3  # a worker is excluded after this many tasks that only it fails at

Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class TaskResult(Generic[Result]):
    """The answer of a task on a worker, and the lines that it wrote."""

    value: Result
    has_failed: bool = False  # whether another worker should try it
    lines: tuple[str, ...] = ()


@dataclass(eq=False, slots=True)
class _Task(Generic[Job, Result]):
    """An unfinished job: the workers that may do it, results of those that failed, and how often all were lost."""

    job: Job
    workers: frozenset[str] = frozenset()
    failed: dict[str, Result] = field(default_factory=dict)
    losses: int = 0


class Cluster:
    """A connection to a cluster's workers. Leaving it as a context cancels its tasks."""

    def __init__(
        self, scheduler: Scheduler, resource: str, refusal: Callable[[], str], *, at_once: int = 1, say: Callable[[str], None]
    ) -> None:
        self._address, self._resource, self._refusal = scheduler.address, resource, refusal
        self._at_once, self._say = at_once, say
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # this module reports problems itself
        self.client = _connect_client(scheduler)
        self._looked, self._told = 0.0, -1
        self._checks: dict[str, Future] = {}  # one for each worker with the resource
        self._refused: dict[str, str] = {}
        self._fit: frozenset[str] = frozenset()
        self._strikes = Counter[str]()
        if "dashboard" in self.client.scheduler_info()["services"]:
            self._say(f"dashboard: {self.client.dashboard_link}")

    @property
    def working(self) -> int:
        """Number of workers that get tasks."""
        return len(self._fit)

    def run(
        self,
        jobs: Iterable[Job],
        call: Callable[[Job], Callable[[], TaskResult[Result] | str]],
        *,
        lost: Result,
        stopping: Callable[[], bool] = lambda: False,
    ) -> Generator[tuple[Job, list[Result]]]:
        """Run jobs; yield each when it ends, with the results of workers that failed, and the last one."""
        waiting, running = deque(_Task[Job, Result](job) for job in jobs), dict[Future, _Task[Job, Result]]()
        ended = as_completed(loop=self.client.loop, with_results=True, raise_errors=False)
        try:
            while waiting or running:
                if stopping():
                    raise Stopped
                is_connected = self._update_workers()
                while is_connected and waiting and self._has_room_for_task(waiting[0], len(running)):
                    task = waiting.popleft()
                    task.workers = self._fit - task.failed.keys() or self._fit
                    future = self._submit_task(
                        _call_on_this_worker, call(task.job), workers=task.workers, retries=MAX_TASK_RETRIES
                    )
                    running[future] = task
                    ended.add(future)
                # Dask would wait for lost workers.
                self._cancel_futures(each for each, task in running.items() if task.workers.isdisjoint(self._checks))
                for future, result in (batch := list(ended.next_batch(block=False))):
                    task = running.pop(future)
                    if results := self._final_task_results(task, result, lost):
                        yield task.job, results
                    elif task.failed or task.losses == MAX_TASK_LOSSES:
                        waiting.append(task)
                    else:
                        waiting.appendleft(task)
                if not batch:
                    time.sleep(POLL_S)
        finally:
            self._cancel_futures(running)

    def _has_room_for_task(self, task: _Task[Job, Result], running: int) -> bool:
        return running < self._at_once * self.working and not (running and task.losses == MAX_TASK_LOSSES)

    def _submit_task(self, function: Callable[..., object], *given: object, workers: Iterable[str], retries: int = 0) -> Future:
        return self.client.submit(
            function, *given, workers=list(workers), resources={self._resource: 1}, retries=retries, pure=False
        )

    def _final_task_results(self, task: _Task[Job, Result], result: Any, lost: Result) -> list[Result]:
        """Return all results of a task that has ended; empty if it must be tried again."""
        error = result[1] if isinstance(result, tuple) else result  # of a failed task: type, error, and traceback
        if isinstance(error, CancelledError | KilledWorker):
            is_last = task.losses == MAX_TASK_LOSSES
            task.losses = MAX_TASK_LOSSES if isinstance(error, KilledWorker) else min(task.losses + 1, MAX_TASK_LOSSES)
            return [*task.failed.values(), lost] if is_last else []
        if isinstance(error, BaseException):
            raise error
        address, answer = result
        if isinstance(answer, str):
            self._exclude_worker(address, answer)
            return []
        for line in answer.lines:
            self._say(f"{address}: {line}")
        results = [*task.failed.values(), answer.value]
        if answer.has_failed:
            task.failed[address] = answer.value
            return results if len(task.failed) > 1 or self._fit <= task.failed.keys() else []
        self._strikes.update(task.failed.keys())
        for failed in task.failed:
            if self._strikes[failed] == MAX_WORKER_STRIKES:
                self._exclude_worker(failed, f"has failed at {MAX_WORKER_STRIKES} tasks that others could do")
        return results

    def _update_workers(self) -> bool:
        if self.client.status == "closed":  # since it was out of reach for `MAX_SCHEDULER_ABSENCE_S`
            remedy = "start one, and run the same command with its address, which continues"
            raise HulldownError("the scheduler is out of reach", path=self._address, remedy=remedy)
        if self.client.status != "running":
            return False
        if time.monotonic() > self._looked + WORKER_CHECK_INTERVAL_S:
            self._looked = time.monotonic()
            with contextlib.suppress(OSError):
                # Client.scheduler_info() is replaced every other second by an answer without workers.
                workers = self.client.sync(self.client.scheduler.identity, n_workers=-1)["workers"]
                self._set_present_workers(
                    {at for at, about in workers.items() if about["resources"].get(self._resource, 0) >= 1}
                )
        for address, check in list(self._checks.items()):
            if check.done() and address not in self._fit | self._refused.keys():
                self._judge_worker(address, check)
        if self._checks and self._checks.keys() <= self._refused.keys():
            address = next(reversed(self._refused))
            raise HulldownError(f"is refused, as all workers are: it {self._refused[address]}", path=address)
        if self.working != self._told:
            self._told = self.working
            many = f"{self._told} workers are in use"
            self._say({0: "waiting for workers", 1: "1 worker is in use"}.get(self._told, many))
        return True

    def _set_present_workers(self, there: set[str]) -> None:
        for address in self._fit - there:
            self._say(f"{address}: is gone; others do its tasks")
        self._fit &= there
        self._refused = {address: why for address, why in self._refused.items() if address in there}
        self._cancel_futures(check for address, check in self._checks.items() if address not in there)
        self._checks = {
            address: self._checks.get(address) or self._submit_task(self._refusal, workers=[address]) for address in there
        }

    def _judge_worker(self, address: str, check: Future) -> None:
        if check.status == "finished" and not (why := check.result()):
            self._fit |= {address}
        elif check.status == "finished":
            self._exclude_worker(address, why)
        elif check.status == "error":
            self._exclude_worker(address, f"fails: {check.exception()!r}")  # a missing module, for example
        else:
            del self._checks[address]  # the scheduler was out of reach, and the worker is checked again

    def _exclude_worker(self, address: str, why: str) -> None:
        self._fit -= {address}
        if address in self._checks and address not in self._refused:
            self._refused[address] = why
            self._say(f"{address}: is not used: it {why}")

    def _cancel_futures(self, futures: Iterable[Future]) -> None:
        if (futures := list(futures)) and self.client.status == "running":
            self.client.cancel(futures, force=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close(timeout=5)


def _call_on_this_worker(call: Callable[[], TaskResult[Result] | str]) -> tuple[str, TaskResult[Result] | str]:
    """Do a task on a worker; return its address, and the answer or the reason why it can't do tasks."""
    address = str(get_worker().address)
    try:
        return address, call()
    except (HulldownError, OSError) as error:
        return address, f"fails: {error}"


def make_task_wanted_check() -> Callable[[], bool]:
    """Return a function that tells, in any thread, whether the client still wants the current task."""
    worker, key = get_worker(), thread_state.key

    def ask() -> bool:
        state = worker.state.tasks.get(key)
        return state is not None and state.state == "executing"

    return ask


def _connect_client(scheduler: Scheduler) -> Client:
    security = Security(require_encryption=True, **scheduler.tls_arguments) if scheduler.tls_arguments else Security()
    address, path = scheduler.address, Path(scheduler.address)
    of_file = address.endswith(".json")
    if of_file and not path.is_file():
        remedy = f"start one with `dask scheduler --scheduler-file {address}`"
        raise HulldownError("there is no such file of a scheduler", path=address, remedy=remedy)
    try:
        found = str(json.loads(path.read_bytes())["address"]) if of_file else address
        with ThreadPoolExecutor(1) as thread:  # a notebook's thread has a loop of its own
            thread.submit(asyncio.run, _wait_for_answer(found, security)).result()
        return Client(found, security=security, timeout=MAX_SCHEDULER_ABSENCE_S, set_as_default=False)
    except (OSError, ValueError, TypeError, KeyError) as error:
        remedy = "start one with `hulldown cluster`, or see docs/cluster.md"
        what = f"no Dask scheduler answers there ({str(error) or 'silence'})"
        raise HulldownError(what, path=address, remedy=remedy) from None


async def _wait_for_answer(address: str, security: Security) -> None:
    """Raise an error unless a scheduler answers at this address; a `Client` would wait for other servers forever."""
    answer = connect(address, **security.get_connection_args("client"))
    await (await asyncio.wait_for(answer, MAX_SCHEDULER_ABSENCE_S)).close()
