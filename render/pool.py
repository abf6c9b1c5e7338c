"""The choice of a renderer, and a pool of Blenders on this machine."""

from __future__ import annotations

import queue
import shutil
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Event
from typing import Annotated, Literal, TypeAlias

from cyclopts import Parameter

from hulldown.base.arguments import Count
from hulldown.base.child import Stopped
from hulldown.base.errors import HulldownError
from hulldown.cluster.scheduler import Scheduler
from hulldown.render.blender.messages import MaskJob, RenderJob
from hulldown.render.process import CHECK_INTERVAL_S, Allowance, Blender, Confinement, Limits, Outcome

MAX_BLENDERS = 256


Device: TypeAlias = Literal["auto", "cpu", "gpu", "optix", "cuda", "hip", "oneapi", "metal"]


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Engine:
    """The renderer: Blender processes on this machine, or the workers of a Dask cluster.

    Parameters
    ----------
    workers
        Processes of this machine; by default one a GPU, or one if there is none.
    device
        What renders; auto is a GPU if there is one.
    blender
        An installed Blender's program, instead of the bpy module.
    scheduler
        Of a Dask cluster whose workers render; by default processes of this machine.
    limits
        Limits of time and memory.
    """

    workers: Count | None = None
    device: Device = "auto"
    blender: str | None = None
    scheduler: Scheduler | None = None
    # whether to use only workers of a cluster that can confine Blender
    require_confinement: Annotated[bool, Parameter(parse=False)] = False
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        alone = next((name for name in ("workers", "blender") if getattr(self, name) is not None), None)
        if alone and self.scheduler is not None:
            remedy = "leave it out: the cluster's workers have their own"
            raise HulldownError(f"--{alone} is for this machine, not for --scheduler", remedy=remedy)
        if self.blender is not None and shutil.which(self.blender) is None:
            raise HulldownError("isn't an executable program", path=self.blender, remedy="name Blender's executable")


DEFAULT_ENGINE = Engine()


class Pool:
    """Several Blenders, each with its own thread, until the context ends; without `confinement` they're unconfined."""

    def __init__(
        self,
        logs: Path,
        engine: Engine,
        *,
        say: Callable[[str], None] = lambda line: None,
        stopping: Callable[[], bool] = lambda: False,
        confinement: Confinement | None = None,
    ) -> None:
        if engine.workers is not None and engine.workers < 1:
            raise ValueError(f"workers: expected at least 1, got {engine.workers}")
        self._logs, self._engine = logs, engine
        self._say, self._stopping, self._confinement = say, stopping, confinement
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()  # from the threads
        self._allowance = Allowance(engine.limits)
        self._blenders: list[Blender] = []
        self._ensure_blender_count(engine.workers or 1)
        self._left = Event()
        self._threads = ThreadPoolExecutor(MAX_BLENDERS)

    @property
    def working(self) -> int:
        """Number of Blenders."""
        return len(self._blenders)

    def _ensure_blender_count(self, blenders: int) -> None:
        for i in range(len(self._blenders), blenders):
            self._blenders.append(
                Blender(
                    self._logs / f"worker-{i}.log",
                    program=self._engine.blender,
                    device=self._engine.device,
                    number=i,
                    allowance=self._allowance,
                    confinement=self._confinement,
                    say=partial(self._queue_worker_line, i),
                )
            )
        self._allowance.blenders = len(self._blenders)

    def _queue_worker_line(self, worker: int, line: str) -> None:
        self._lines.put(f"worker {worker}: {line}")

    def results(self, jobs: Sequence[int], job_of: Callable[[int], RenderJob | MaskJob]) -> Iterator[tuple[int, Outcome]]:
        """Do all jobs, neighbors in one Blender, since they should share assets; yield each with its outcome."""
        n = self.working
        queues = [deque(jobs[i * len(jobs) // n : (i + 1) * len(jobs) // n]) for i in range(n)]
        running: dict[Future[Outcome], tuple[int, int]] = {}  # queue and job of each, ended ones included
        while any(queues) or running:
            self._say_queued_lines()
            ended, stopping = next((future for future in running if future.done()), None), self._stopping()
            if stopping and ended is None:
                raise Stopped
            if self._engine.workers is None:
                self._ensure_blender_count(self._blenders[0].devices)
                queues += [deque[int]() for _ in range(self.working - len(queues))]
            idle = set(range(self.working)) - {i for future, (i, _) in running.items() if not future.done()}
            for i in () if stopping else idle:
                if (job := _pop_or_steal_job(queues, i)) is not None:
                    do = self._blenders[i].do
                    running[self._threads.submit(do, job_of(job), stopping=self._left.is_set)] = i, job
            if ended is None:
                wait(running, timeout=CHECK_INTERVAL_S, return_when=FIRST_COMPLETED)
                continue
            (_, job), outcome = running.pop(ended), ended.result()
            yield job, outcome  # all Blenders work meanwhile

    def _say_queued_lines(self) -> None:
        while not self._lines.empty():
            self._say(self._lines.get())

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._threads.shutdown(cancel_futures=True)
        for blender in self._blenders:
            blender.close()


def _pop_or_steal_job(queues: Sequence[deque[int]], i: int) -> int | None:
    """Take the next job of a queue; an empty queue takes half of the longest one's jobs."""
    if not queues[i]:
        longest = max(queues, key=len)
        half = [longest.pop() for _ in range((len(longest) + 1) // 2)]
        queues[i].extend(reversed(half))
    return queues[i].popleft() if queues[i] else None
