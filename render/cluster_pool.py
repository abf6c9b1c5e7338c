"""Render rows on the workers of a Dask cluster, like `render.pool.Pool`; each row is a task."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from hulldown.base.code import package_versions
from hulldown.cluster.scheduler import RESOURCE, Scheduler
from hulldown.cluster.workers import Answer, Cluster
from hulldown.plan.library import Library
from hulldown.render.blender.messages import RenderJob
from hulldown.render.jobs import readable_paths
from hulldown.render.node import Setting, refusal_reason, render_row, shared_files
from hulldown.render.pool import Engine
from hulldown.render.process import Outcome

AT_ONCE = 2  # tasks per worker: the current and the next one
LOST = "its workers were lost, the last ones while they had nothing else to do"


class ClusterPool(Cluster):
    """The workers of a Dask cluster. Leaving it as a context cancels waiting tasks."""

    def __init__(
        self,
        scheduler: Scheduler,
        engine: Engine,
        library: Library,
        *,
        say: Callable[[str], None],
        stopping: Callable[[], bool],
    ) -> None:
        self._stopping = stopping
        self._setting = Setting(readable_paths(library), engine.device, engine.limits)
        refused = partial(refusal_reason, package_versions("bpy"), engine.require_confinement, shared_files(library))
        super().__init__(scheduler, RESOURCE, refused, at_once=AT_ONCE, say=say)

    def results(self, jobs: Sequence[int], job_of: Callable[[int], RenderJob]) -> Iterator[tuple[int, Outcome]]:
        """Do all jobs; parameters and errors as of `render.pool.Pool.results`."""

        def call(job: int) -> Callable[[], Answer[Outcome]]:
            return partial(render_row, self._setting, job_of(job))

        lost = Outcome(reasons=(LOST,))
        for job, outcomes in self.run(jobs, call, lost=lost, stopping=self._stopping):
            reasons = [reason for outcome in outcomes for reason in outcome.reasons] if outcomes[-1].reasons else []
            restarts = sum(outcome.restarts for outcome in outcomes)
            yield job, replace(outcomes[-1], reasons=tuple(reasons), restarts=restarts)
