"""Render rows on the workers of a Dask cluster, like `render.pool.Pool`; each row is a task."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any

from hulldown.geometry.code import versions
from hulldown.render.cluster.asset_files import ClientFiles
from hulldown.render.cluster.node import Order, refusal, render_row
from hulldown.render.cluster.scheduler import Scheduler
from hulldown.render.cluster.workers import Cluster
from hulldown.render.jobs import RenderAssets
from hulldown.render.process import Limits, Outcome, Stopped

RESOURCE = "render"  # declared by `dask worker --resources "render=1"`
AT_ONCE = 2  # tasks per worker: the current and the next one
LOST = "its workers were lost, the last ones while they had nothing else to do"


class ClusterPool:
    """The workers of a Dask cluster. Leaving it as a context cancels waiting tasks.

    Parameters
    ----------
    scheduler
        The cluster's scheduler.
    assets
        The plan's files.
    device
        A device for `render.blender.cycles.choose_device`.
    limits
        Limits of time, memory, and attempts.
    say
        Called with messages for the user.
    stopping
        Called several times a second; true: stop now.
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
        self._device, self._limits, self._say, self._stopping = device, limits, say, stopping
        self._files = ClientFiles(assets)
        self._cluster = Cluster(
            scheduler, RESOURCE, refusal, (versions("bpy"), require_confinement), at_once=AT_ONCE, say=say
        )

    @property
    def working(self) -> int:
        """Number of workers that get rows."""
        return len(self._cluster.fit)

    def results(
        self, jobs: Sequence[int], message: Callable[[int], Mapping[str, Any]]
    ) -> Iterator[tuple[int, Outcome]]:
        """Do all jobs; parameters and errors as of `render.pool.Pool.results`."""
        left, unconfined = len(jobs), set[str]()

        def order(job: int) -> Order:
            job_message = message(job)
            named = {
                job_message["scenery"]["path"],
                job_message["light"]["hdri"],
                *(vehicle["tidy"] for vehicle in job_message["vehicles"]),
            }
            assets = tuple(self._files.asset(path) for path in sorted(named))
            return Order(job_message, assets, self._files.key, self._device, self._limits)

        answers = self._cluster.results(jobs, render_row, order, stopping=self._stopping, content=self._files.content)
        for job, answer in answers:
            outcome = answer.value if answer else Outcome(reasons=(LOST,))
            why = outcome.confinement
            if answer and why not in unconfined and why.startswith("none"):
                unconfined.add(why)
                self._say(f"{answer.worker}: Blender is not confined there, {why}; see docs/safety.md")
            left -= 1
            yield job, outcome
        if left:
            raise Stopped

    def __enter__(self) -> ClusterPool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cluster.__exit__(kind, error, trace)
