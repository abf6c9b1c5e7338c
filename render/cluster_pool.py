"""Render rows on the workers of a Dask cluster, like `render.pool.Pool`; each row is a task."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

from distributed import get_worker

from hulldown.base.child import Stopped
from hulldown.base.code import NOT_INSTALLED, describe_version_difference, package_versions
from hulldown.base.files import open_regular_file
from hulldown.cluster.scheduler import RENDER_RESOURCE, SHARE_VARIABLE, Scheduler
from hulldown.cluster.workers import Cluster, TaskResult, make_task_wanted_check
from hulldown.plan.library import Library
from hulldown.reading.confinement import landlock
from hulldown.render.blender.messages import RenderJob
from hulldown.render.jobs import blender_readable_paths
from hulldown.render.pool import Engine
from hulldown.render.process import Allowance, Blender, Confinement, Limits, Outcome

TASKS_PER_WORKER = 2  # the current and the next one
LOST_WORKERS = "its workers were lost, the last ones while they had nothing else to do"
SHARED_FOLDER_REMEDY = "all machines must share it; without a shared folder, render with `--share K/N`, and `hulldown join`"
MAX_IDLE_S = 60.0  # then Blender is ended to free memory


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
        self._setting = Setting(blender_readable_paths(library), engine.device, engine.limits)
        refused = partial(
            worker_refusal_reason, package_versions("bpy"), engine.require_confinement, shared_file_stamps(library)
        )
        super().__init__(scheduler, RENDER_RESOURCE, refused, at_once=TASKS_PER_WORKER, say=say)

    def results(self, jobs: Sequence[int], job_of: Callable[[int], RenderJob]) -> Iterator[tuple[int, Outcome]]:
        """Do all jobs; parameters and errors as for `render.pool.Pool.results`."""

        def call(job: int) -> Callable[[], TaskResult[Outcome]]:
            return partial(render_on_this_worker, self._setting, job_of(job))

        lost = Outcome(reasons=(LOST_WORKERS,))
        for job, outcomes in self.run(jobs, call, lost=lost, stopping=self._stopping):
            reasons = [reason for outcome in outcomes for reason in outcome.reasons] if outcomes[-1].reasons else []
            restarts = sum(outcome.restarts for outcome in outcomes)
            yield job, replace(outcomes[-1], reasons=tuple(reasons), restarts=restarts)


def shared_file_stamps(library: Library) -> dict[str, tuple[int, int]]:
    """Return size and time of each file in `render.jobs.blender_readable_paths` that renders read, by absolute path."""
    read = (*library.models.values(), *library.sceneries.values())
    named = [hdri.path for hdri in library.hdris.values()]
    for exported in read:
        named += [exported.tidy, Path(exported.report.path), *map(Path, exported.files)]
    allowed, files = blender_readable_paths(library), dict[str, tuple[int, int]]()
    for path in named:
        if path.is_file() and landlock.is_in_readable_folder(path, allowed):
            stat = path.stat()
            files[str(path.absolute())] = stat.st_size, stat.st_mtime_ns
    return files


def worker_refusal_reason(client: Mapping[str, str], require_confinement: bool, files: Mapping[str, tuple[int, int]]) -> str:
    """Return why this process can't render for a client with these `shared_file_stamps`; empty if it can."""
    if package_versions("bpy")["bpy"] == NOT_INSTALLED:
        return "has no bpy"
    if wrong := describe_version_difference({name: version for name, version in client.items() if version != NOT_INSTALLED}):
        return wrong
    if require_confinement and (why := landlock.unconfined_reason()):
        return f"can't confine Blender: {why}"
    for path, (size, changed) in files.items():
        try:
            with open_regular_file(Path(path)) as file:
                stat = os.fstat(file.fileno())
        except OSError:
            return f"cannot read {path}: {SHARED_FOLDER_REMEDY}"
        if (stat.st_size, stat.st_mtime_ns) != (size, changed):
            return f"sees another {path}: {SHARED_FOLDER_REMEDY}"
    return ""


@dataclass(frozen=True, slots=True)
class Setting:
    """What a plan's Blenders start with."""

    readable: tuple[Path, ...]  # paths that they may read, by `render.jobs.blender_readable_paths`
    device: str
    limits: Limits


def render_on_this_worker(setting: Setting, job: RenderJob) -> TaskResult[Outcome]:
    """Render an image on this Dask worker, with a Blender of this setting."""
    is_wanted, opened = make_task_wanted_check(), _worker_blender()
    with opened.use_blender(setting):
        output = opened.pictures / "picture.png"
        try:
            outcome = opened.blender.do(replace(job, output=str(output)), stopping=lambda: not is_wanted())
        except Stopped:
            return TaskResult(Outcome())
        output.unlink(missing_ok=True)
        lines, opened.lines[:] = tuple(opened.lines), []
        return TaskResult(outcome, has_failed=bool(outcome.reasons), lines=lines)


@cache
def _worker_blender() -> OpenBlender:
    return OpenBlender(Path(get_worker().local_directory) / "hulldown")


class OpenBlender:
    """A Dask worker's Blender, from the first image to the process's end, and unsent `lines`; writes to `scratch`."""

    blender: Blender  # for the setting of the last `use_blender`

    def __init__(self, scratch: Path) -> None:
        self._scratch, self.pictures = scratch, scratch / "pictures"
        self.pictures.mkdir(parents=True, exist_ok=True)
        self._setting: Setting | None = None
        self.lines: list[str] = []
        self._busy = threading.Lock()
        self._idle = threading.Timer(MAX_IDLE_S, self._end_idle)

    def _end_idle(self) -> None:
        with self._busy:
            if self._setting is not None:
                self.blender.close()  # the next image starts another

    @contextmanager
    def use_blender(self, setting: Setting) -> Iterator[None]:
        """Yield a Blender for a setting; it stays open for `MAX_IDLE_S` after the block."""
        self._idle.cancel()
        try:
            with self._busy:
                if setting != self._setting:
                    self._replace_blender(setting)
                yield
        finally:
            self._idle = threading.Timer(MAX_IDLE_S, self._end_idle)
            self._idle.daemon = True
            self._idle.start()

    def _replace_blender(self, setting: Setting) -> None:
        if self._setting is not None:
            self.blender.close()
        self._setting = None  # should any of this fail
        self.blender = Blender(
            self._scratch / "logs" / "blender.log",
            device=setting.device,
            allowance=Allowance(setting.limits, max(1, int(os.environ.get(SHARE_VARIABLE, "1")))),
            confinement=Confinement(self.pictures, setting.readable),
            say=self.lines.append,
        )
        if why := landlock.unconfined_reason():
            self.lines.append(f"Blender is not confined there: {why}; see docs/safety.md")
        self._setting = setting
