"""Rows rendered by the workers of a Dask cluster, in place of a `render.pool.Pool`: a row is a task."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from distributed import Future, KilledWorker

from hulldown.geometry.code import versions
from hulldown.geometry.errors import HulldownError
from hulldown.render.cluster.asset_files import AssetNote, ClientFiles
from hulldown.render.cluster.node import Answer, Order, refusal, render_row
from hulldown.render.cluster.scheduler import Scheduler
from hulldown.render.cluster.workers import Cluster
from hulldown.render.jobs import RenderAssets
from hulldown.render.messages import RenderJob, from_json
from hulldown.render.pool import Limits, Stopped

RESOURCE = "render"  # what `dask worker --resources "render=1"` declares
IN_FLIGHT = 2  # tasks per worker: the one that it renders, and the next
POLL_S = 0.05
GATHER_S = 60.0  # that a picture may take over the network before it's asked for again
LOSSES = 3  # of workers over a row
STRIKES = 3  # images that a worker fails at and others don't, until it gets no more


@dataclass(eq=False, slots=True)
class _Row:
    """A row that isn't rendered yet.

    Parameters
    ----------
    job
        The caller's number for it.
    output
        Where its picture goes.
    failed_on
        Workers that failed at it.
    contents
        Files that its next worker is sent.
    losses
        How often it was lost with a worker.
    is_suspect
        Whether it's tried alone, since it may be what ends workers.
    """

    job: int
    output: Path = Path()
    failed_on: list[str] = field(default_factory=list)
    contents: list[Future] = field(default_factory=list)
    losses: int = 0
    is_suspect: bool = False


class ClusterPool:
    """The workers of a Dask cluster. Leaving it as a context takes back what they haven't begun.

    Parameters
    ----------
    scheduler
        The cluster's.
    assets
        What the plan is rendered from.
    device
        What `render.blender.cycles.choose_device` takes.
    limits
        When a row is given up.
    say
        Called with a line for the user, now and then.
    stopping
        Asked several times a second whether to give up now.
    require_confinement
        Whether to refuse workers that can't confine Blender.

    Raises
    ------
    HulldownError
        If no scheduler answers.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        assets: RenderAssets,
        *,
        device: str,
        limits: Limits,
        say: Callable[[str], None],
        stopping: Callable[[], bool],
        require_confinement: bool = False,
    ) -> None:
        self.restarts = 0
        self.devices: set[str] = set()
        self.systems: set[str] = set()
        self.confinements: set[str] = set()
        self.blender_version = ""
        self._address, self._device, self._limits = scheduler.address, device, limits
        self._say, self._stopping = say, stopping
        self._files = ClientFiles(assets)
        self._strikes: dict[str, int] = {}
        self._cluster = Cluster(scheduler, RESOURCE, refusal, (versions("bpy"), require_confinement), say=say)

    @property
    def working(self) -> int:
        """How many workers get rows."""
        return len(self._cluster.fit)

    def run(
        self,
        jobs: Sequence[int],
        message: Callable[[int], Mapping[str, Any]],
        done: Callable[[int, dict[str, Any]], str | None],
        failed: Callable[[int, list[str]], None],
    ) -> None:
        """Do all jobs; parameters and errors as of `render.pool.Pool.run`."""
        self._message, self._done, self._failed = message, done, failed
        self._waiting, self._suspects = deque(_Row(job) for job in jobs), deque[_Row]()
        self._running: dict[Future, _Row] = {}
        self._left, self._failed_in_a_row = len(jobs), 0
        while self._left:
            if self._stopping():
                raise Stopped
            if self._cluster.look():
                self._feed()
            ended = [future for future in self._running if future.done()]
            for future in ended:
                self._hear(future)
            if not ended:
                time.sleep(POLL_S)

    def _feed(self) -> None:
        """Submit the next rows, as many as the workers need; suspects one at a time after all others."""
        room = IN_FLIGHT * len(self._cluster.fit) - len(self._running)
        for _ in range(min(room, len(self._waiting))):
            self._submit(self._waiting.popleft())
        if self._cluster.fit and self._suspects and not self._running and not self._waiting:
            self._submit(self._suspects.popleft())

    def _submit(self, row: _Row) -> None:
        job = from_json(self._message(row.job))
        assert isinstance(job, RenderJob)
        row.output = Path(job.output)
        order = Order(job, self._assets_of(job), self._files.key, self._device, self._limits.job_s)
        future = self._cluster.submit(render_row, order, *row.contents, avoiding=row.failed_on)
        self._running[future] = row

    def _assets_of(self, job: RenderJob) -> tuple[AssetNote, ...]:
        named = {job.scenery.path, job.light.hdri, *(vehicle.tidy for vehicle in job.vehicles)}
        return tuple(self._files.asset(path) for path in sorted(named))

    def _hear(self, future: Future) -> None:
        """A task has ended, with an answer or without."""
        row = self._running.pop(future)
        try:
            answer: Answer = future.result(timeout=GATHER_S)
        except TimeoutError:
            self._running[future] = row
        except CancelledError:  # with its workers, its contents or the scheduler
            self._lost(row, 1)
        except KilledWorker:  # Dask has tried it on several workers
            self._lost(row, LOSSES)
        else:
            self._take_in(row, answer)

    def _lost(self, row: _Row, times: int) -> None:
        """Workers were lost with a row: it's tried again, then alone, and then given up."""
        row.contents = []
        row.losses += times
        if row.losses < LOSSES:
            self._waiting.appendleft(row)
        elif not row.is_suspect:
            row.is_suspect, row.losses = True, 0
            self._suspects.append(row)
        else:
            self._give_up(row, ["its workers were lost, the last ones while they had nothing else to do"])

    def _take_in(self, row: _Row, answer: Answer) -> None:
        for line in answer.lines:
            self._say(f"{answer.worker}: {line}")
        row.contents = []
        self.restarts += answer.restarts
        if answer.refused:
            self._cluster.refuse(answer.worker, answer.refused)
            self._waiting.appendleft(row)
        elif answer.lacking:
            found = (self._cluster.content(digest, self._files.content, answer.worker) for digest in answer.lacking)
            row.contents = [future for future in found if future is not None]
            self._waiting.appendleft(row)
        elif answer.reasons:
            self._attempts_failed(row, answer.worker, list(answer.reasons))
        else:
            self._receive(row, answer)

    def _receive(self, row: _Row, answer: Answer) -> None:
        """Treat a picture like one of a worker of this machine."""
        self.blender_version = answer.blender
        self.devices.add(answer.device)
        self.systems.add(answer.system)
        if answer.confinement not in self.confinements and answer.confinement.startswith("none"):
            self._say(f"{answer.worker}: Blender is not confined there, {answer.confinement}; see docs/safety.md")
        self.confinements.add(answer.confinement)
        try:
            row.output.write_bytes(answer.png)
        except OSError as error:
            raise HulldownError(
                f"cannot be written ({error.strerror})",
                path=row.output,
                remedy="make room and run the same command again, which continues",
            ) from error
        if wrong := self._done(row.job, {"done": "render", "device": answer.device}):
            self._attempts_failed(row, answer.worker, [wrong])
            return
        self._left -= 1
        self._failed_in_a_row = 0
        for address in row.failed_on:
            self._strikes[address] = self._strikes.get(address, 0) + 1
            if self._strikes[address] == STRIKES:
                self._cluster.refuse(address, f"has failed at {STRIKES} images that others could render")

    def _attempts_failed(self, row: _Row, worker: str, reasons: list[str]) -> None:
        """A worker has given a row up; so does the run, once another has too, or if there is no other."""
        row.failed_on.append(worker)
        if len(row.failed_on) < 2 and self._cluster.fit - {worker}:
            self._waiting.appendleft(row)
        else:
            self._give_up(row, reasons)

    def _give_up(self, row: _Row, reasons: list[str]) -> None:
        self._left -= 1
        self._failed_in_a_row += len(reasons)
        self._failed(row.job, reasons)
        if self._failed_in_a_row >= self._limits.give_up_after:
            raise HulldownError(
                f"{self._failed_in_a_row} attempts have failed one after the other, the last with: {reasons[-1]}",
                path=self._address,
                remedy="mend the cause and run again, which continues",
            )

    def __enter__(self) -> ClusterPool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cluster.__exit__(kind, error, trace)
