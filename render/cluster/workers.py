"""The workers of a Dask cluster that can do this client's tasks; knows nothing about pictures or trainings.

Dask schedules tasks, gives those of a lost worker to others, and moves data. This module leaves out workers that can't
do the tasks, which Dask doesn't know.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
import time
import uuid
from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError
from pathlib import Path
from types import TracebackType
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary

from distributed import Client, Future, Security, get_worker
from distributed.comm import CommClosedError
from distributed.worker import thread_state

from hulldown.geometry.errors import HulldownError
from hulldown.render.cluster.scheduler import Scheduler

GONE_S = 15.0  # how long a scheduler may be out of reach
LOOK_S = 1.0  # how often the client asks which workers there are


class Cluster:
    """A connection to the workers of a cluster. Leaving it as a context takes back its tasks.

    Parameters
    ----------
    scheduler
        The cluster's.
    resource
        What a worker must have to get tasks, one of it for each: ``dask worker --resources "NAME=1"``.
    refusal
        Called on each new worker with `about`; returns why it can't do the tasks, empty if it can.
    about
        Data of the client.
    say
        Told a line now and then.

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
        say: Callable[[str], None],
    ) -> None:
        self._address, self._resource = scheduler.address, resource
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()  # of other threads too
        self._tell, self._say = say, self._lines.put
        self._refusal, self._about = refusal, about
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # we report what matters
        self.client = _connect(scheduler)
        self._lock = threading.RLock()
        self._reached, self._looked = time.monotonic(), 0.0
        self._fit: set[str] = set()
        self._refused: dict[str, str] = {}
        self._asked: set[str] = set()
        self._told = -1
        self._tasks: WeakKeyDictionary[Future, frozenset[str]] = WeakKeyDictionary()  # who may do each
        self._contents: WeakValueDictionary[str, Future] = WeakValueDictionary()
        if "dashboard" in self.client.scheduler_info()["services"]:
            self._say(f"dashboard: {self.client.dashboard_link}")

    @property
    def fit(self) -> frozenset[str]:
        """Addresses of the workers that get tasks."""
        return frozenset(self._fit)

    def look(self) -> bool:
        """Find workers that came or went; whether the scheduler is in reach.

        Raises
        ------
        HulldownError
            If the scheduler is lost, or there are workers and all are refused.
        """
        self._tell_lines()
        with self._lock:
            if not self._is_connected():
                return False
            if time.monotonic() > self._looked + LOOK_S:
                self._looked = time.monotonic()
                with contextlib.suppress(OSError):
                    self._count(self._workers())
            if self._asked and self._asked <= self._refused.keys():
                address = next(reversed(self._refused))
                raise HulldownError(f"is refused, as all workers are: it {self._refused[address]}", path=address)
            return True

    def _tell_lines(self) -> None:
        while not self._lines.empty():
            self._tell(self._lines.get())

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
        found = self.client.sync(self.client.scheduler.identity, n_workers=-1)["workers"]
        return {address for address, about in found.items() if about["resources"].get(self._resource, 0) >= 1}

    def _count(self, there: set[str]) -> None:
        for address in self._fit - there:
            self._say(f"{address}: is gone; others do its tasks")
        self._fit &= there
        self._refused = {address: why for address, why in self._refused.items() if address in there}
        self._asked &= there
        for address in there - self._asked:
            self._asked.add(address)
            threading.Thread(target=self._ask, args=(address,), daemon=True).start()
        if len(self._fit) != self._told and (self._fit or self._asked == self._refused.keys()):
            self._told = len(self._fit)
            many = f"{self._told} workers are in use"
            self._say({0: "waiting for workers", 1: "1 worker is in use"}.get(self._told, many))
        # Dask would wait for one of the workers that a task was meant for.
        self.cancel([task for task, workers in self._tasks.items() if not workers & there and not task.done()])

    def _ask(self, address: str) -> None:
        """Find out whether a worker can do the tasks; in a thread, since a worker may never answer."""
        try:
            answers = self.client.run(self._refusal, *self._about, workers=[address], on_error="return")
            answer = answers.get(address, OSError())
        except (OSError, CancelledError) as error:
            answer = error
        with self._lock:
            if isinstance(answer, OSError | CommClosedError | CancelledError):
                self._asked.discard(address)  # it's gone, or will be asked again
            elif answer:
                why = answer if isinstance(answer, str) else f"fails: {type(answer).__name__}: {answer}"
                self.refuse(address, why)
            elif address in self._asked:
                self._fit.add(address)

    def refuse(self, address: str, why: str) -> None:
        """Give a worker no more tasks; `why` completes a sentence about it."""
        with self._lock:
            if address not in self._refused:
                self._refused[address] = why
                self._say(f"{address}: is not used: it {why}")
            self._fit.discard(address)

    def submit(self, function: Callable[..., Any], *data: Any, avoiding: Iterable[str] = ()) -> Future:
        """Have one of the fit workers call a function; not one of `avoiding` if there's another.

        A future that ends as cancelled was lost with its workers or data, and can be submitted again.
        """
        with self._lock:
            workers = self.fit - set(avoiding) or self.fit
            future = self.client.submit(
                function,
                *data,
                key=f"hulldown-{uuid.uuid4().hex}",
                workers=sorted(workers),
                allow_other_workers=False,
                resources={self._resource: 1},
                pure=False,
            )
            self._tasks[future] = workers
            return future

    def content(self, digest: str, read: Callable[[str], bytes], worker: str) -> Future | None:
        """Data in the cluster's memory by its SHA-256, put on a worker first; None if that worker is gone."""
        future = self._contents.get(digest)
        if future is None or future.status in ("cancelled", "lost", "error"):
            try:
                key = f"hulldown-{digest}"
                future = self.client.scatter({key: read(digest)}, workers=[worker])[key]
            except (OSError, ValueError, KeyError, TimeoutError):
                return None
            self._contents[digest] = future
        return future

    def cancel(self, futures: Iterable[Future]) -> None:
        """Take tasks back; one that has begun finds out by `wanted`."""
        if (futures := list(futures)) and self.client.status == "running":
            self.client.cancel(futures, force=True)

    def __enter__(self) -> Cluster:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.client.close(timeout=5)
        self._tell_lines()


def own_address() -> str:
    """For the task that calls this: its worker's address."""
    return str(get_worker().address)


def wanted() -> Callable[[], bool]:
    """For the task that calls this: a function that tells, in any thread, whether the client still waits for it."""
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
