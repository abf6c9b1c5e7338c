"""Tasks on the workers of a Dask cluster, each on a worker of the caller's choice; knows nothing of pictures.

A task may run on its worker only. So there is nothing for Dask to steal, and no task counts how many workers were lost:
the caller sees that a worker is gone and gives its tasks to others. Dask's `allow_other_workers` would do that too, but
also on workers without the resource that the task needs, whose tasks then never start.
"""

from __future__ import annotations

import asyncio
import logging
import queue
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from distributed import Client, Future, Security, get_worker
from distributed.worker import thread_state

from geometry.errors import HulldownError
from render.scheduler import Scheduler

GONE_S = 15.0  # how long a scheduler may be out of reach
LOOK_S = 1.0  # how often is asked which workers there are


@dataclass(eq=False, slots=True)
class Task:
    """What a worker does: its address, and Dask's handle."""

    worker: str
    future: Future


class Tasks:
    """A connection to a cluster.

    Parameters
    ----------
    scheduler
        The cluster's.
    resource
        What a worker must have to get tasks, one of it for each: `dask worker --resources "NAME=1"`.

    Attributes
    ----------
    events
        Tasks that have ended, each with its result, or with why there is none.

    Raises
    ------
    HulldownError
        If the scheduler is not there.
    """

    def __init__(self, scheduler: Scheduler, resource: str) -> None:
        self.events: queue.SimpleQueue[tuple[Task, bytes | BaseException]] = queue.SimpleQueue()
        self._address, self._resource = scheduler.address, resource
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # the caller says what matters of it
        self._client = _connect(scheduler)
        self._reached = time.monotonic()
        self._looked = 0.0

    @property
    def dashboard(self) -> str:
        """Where the cluster can be watched in a browser; empty if nowhere."""
        services = self._client.scheduler_info()["services"]
        return str(self._client.dashboard_link) if "dashboard" in services else ""

    @property
    def connected(self) -> bool:
        """Whether the scheduler is there.

        Raises
        ------
        HulldownError
            If it has not been for a while.
        """
        now = time.monotonic()
        if self._client.status == "running":
            self._reached = now
            return True
        if self._client.status == "closed" or now > self._reached + GONE_S:
            raise HulldownError(
                "the scheduler is out of reach",
                path=self._address,
                remedy="start one, and run the same command with its address, which goes on from here",
            )
        return False

    def workers(self) -> dict[str, bool] | None:
        """The workers that have the resource, and whether they take tasks; None as long as the last answer holds."""
        now = time.monotonic()
        if now < self._looked + LOOK_S or not self.connected:
            return None
        self._looked = now
        try:
            # What Client.scheduler_info gives is replaced every other second, by an answer without workers.
            found = self._client.sync(self._client.scheduler.identity, n_workers=-1)["workers"]
        except OSError:
            return None
        return {
            address: about["status"] == "running"
            for address, about in found.items()
            if about["resources"].get(self._resource, 0) >= 1
        }

    def submit(self, worker: str, function: Callable[..., bytes], *data: bytes) -> Task:
        """Have a worker call a function of a module that it has too."""
        future = self._client.submit(
            function,
            *data,
            key=f"hulldown-{uuid.uuid4().hex}",
            workers=[worker],
            allow_other_workers=False,
            resources={self._resource: 1},
            pure=False,
        )
        task = Task(worker, future)
        assert self._client.loop is not None
        self._client.loop.add_callback(self._listen, task)
        return task

    async def _listen(self, task: Task) -> None:
        """Pass on how a task has ended; runs in Dask's own thread."""
        outcome: bytes | BaseException
        try:
            outcome = await self._client.gather(task.future, asynchronous=True)
        except (Exception, asyncio.CancelledError) as error:
            outcome = error
        self.events.put((task, outcome))

    def take_back(self, tasks: Sequence[Task]) -> None:
        """Forget tasks; those that have begun come to their end unheard."""
        if tasks and self._client.status == "running":
            self._client.cancel([task.future for task in tasks], force=True)

    def failed(self, task: Task) -> bool:
        """Whether a task that ended without a result failed by itself, and not because the scheduler was lost."""
        return self._client.status == "running" and not task.future.cancelled()

    def close(self) -> None:
        """Leave the cluster."""
        self._client.close(timeout=5)


def wanted() -> Callable[[], bool]:
    """For the task that calls this: what says, from any thread, whether the client still waits for it."""
    worker, key = get_worker(), thread_state.key

    def ask() -> bool:
        state = worker.state.tasks.get(key)
        return state is not None and state.state == "executing"

    return ask


def scratch() -> Path:
    """The folder that the worker which calls this has on its machine."""
    return Path(get_worker().local_directory) / "hulldown"


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
