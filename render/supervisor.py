"""Render a plan into a dataset, unattended: resumes, survives crashes of Blender, and stops cleanly."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from hulldown.base.arguments import AnyPath
from hulldown.base.child import Stopped
from hulldown.base.errors import HulldownError
from hulldown.base.terminal import is_interactive, one_bar_for_all_titles, print_message
from hulldown.cluster.scheduler import Scheduler, explain_missing_dask
from hulldown.dataset.coco import LOGS_NAME, CocoDataset
from hulldown.dataset.provenance import FAILURES_NAME
from hulldown.dataset.store.placed_pictures import require_path_inside
from hulldown.dataset.table import Dataset
from hulldown.plan.library import Library, load_planned_library
from hulldown.plan.plan_file import read_plan
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.render.jobs import blender_readable_paths
from hulldown.render.outline import WHOLE_PLAN, Outline, Part
from hulldown.render.pool import DEFAULT_ENGINE, Device, Engine, Pool
from hulldown.render.process import Confinement
from hulldown.render.session import RenderProgress, Session

if TYPE_CHECKING:
    from hulldown.render.cluster_pool import ClusterPool


@dataclass(frozen=True, slots=True)
class RenderReport:
    """The outcome of a run: its images, restarts, and duration."""

    images: int  # number of wanted images of the plan
    already: int  # number of these that were in the dataset before
    rendered: int
    failed: tuple[str, ...]  # file names of failed images; `failures.jsonl` has the reasons
    restarts: int  # how often Blender had to be started again
    interrupted: bool  # whether the run was stopped early
    seconds: float

    @property
    def complete(self) -> bool:
        """Whether every wanted image is in the dataset."""
        return self.already + self.rendered == self.images


def render_plan(
    plan: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    workers: int | None = None,
    scheduler: str | Scheduler | None = None,
    device: Device = "auto",
    part: Part = WHOLE_PLAN,
    cache: str | os.PathLike[str] | None = None,
    progress: Callable[[RenderProgress], None] | None = None,
) -> Dataset:
    """Render a plan's missing images into the dataset in `folder`, and return it.

    After a stop, the same call continues. Failed images give warnings.

    Parameters
    ----------
    plan
        A plan, or its file.
    folder
        The dataset to add to; made if it isn't there.
    workers
        Processes of this machine; None for one a GPU, or one if there is none.
    scheduler
        Of a Dask cluster whose workers render, or its address; None for processes of this machine.
    device
        "auto", "cpu", "gpu", "optix", "cuda", "hip", "oneapi" or "metal".
    part
        The part of the plan to render.
    cache
        Where the plan's assets are kept; beside the plan if None.
    progress
        Called after each image and with each message; None for a bar on a terminal or in a notebook.

    Raises
    ------
    HulldownError
        If plan, assets or dataset can't be used, or Blender doesn't work at all.
    KeyboardInterrupt
        If it was stopped; what was rendered is kept.

    Examples
    --------
    >>> dataset = render("project/plan.jsonl", "project/dataset")  # doctest: +SKIP
    """
    scheduler = Scheduler(scheduler) if isinstance(scheduler, str) else scheduler
    engine = Engine(workers=workers, device=device, scheduler=scheduler)
    report = render_remaining_images(plan, folder, engine=engine, part=part, cache=cache, progress=progress)
    if report.interrupted:
        raise KeyboardInterrupt
    if report.failed:
        warnings.warn(f"{len(report.failed)} images failed; reasons are in {Path(folder) / FAILURES_NAME}", stacklevel=2)
    return Dataset.read(folder)


def _make_pool(
    engine: Engine, logs: Path, library: Library, session: Session, stopping: Callable[[], bool]
) -> Pool | ClusterPool:
    if engine.scheduler is None:
        confinement = Confinement(session.unfinished, blender_readable_paths(library))
        return Pool(logs, engine, say=session.report_progress, stopping=stopping, confinement=confinement)
    with explain_missing_dask():
        from hulldown.render.cluster_pool import ClusterPool
    return ClusterPool(engine.scheduler, engine, library, say=session.report_progress, stopping=stopping)


@contextlib.contextmanager
def render_progress_bar() -> Iterator[Callable[[RenderProgress], None]]:
    """Show a bar on stderr with messages above it; yield the function that `render_plan` calls."""
    with one_bar_for_all_titles(unit="images") as advance:

        def show(progress: RenderProgress) -> None:
            if progress.line:
                print_message(progress.line)
            workers = {0: "", 1: " on 1 worker"}.get(progress.workers, f" on {progress.workers} workers")
            advance(f"rendering{workers}", progress.finished, progress.images)

        yield show


def render_remaining_images(
    plan: AnyPath,
    output: AnyPath,
    library: Library | None = None,
    *,
    engine: Engine = DEFAULT_ENGINE,
    part: Part = WHOLE_PLAN,
    cache: AnyPath | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
    progress: Callable[[RenderProgress], None] | None = None,
) -> RenderReport:
    """Render a plan with Blender Cycles.

    Reads a plan and the assets it names; writes the images that the dataset lacks, annotations.json, and a journal. The
    same call continues one that was stopped.

    Parameters
    ----------
    plan
        The plan.
    output
        The dataset, which may exist.
    engine
        The renderer.
    part
        The part of the plan to render.
    cache
        Cache of assets; by default .hulldown-cache next to the plan.
    limits
        Time and memory for reading an asset.
    """
    if progress is None and is_interactive():
        with render_progress_bar() as bar:
            return render_remaining_images(
                plan, output, library, engine=engine, part=part, cache=cache, limits=limits, progress=bar
            )
    start = time.monotonic()
    plan = read_plan(plan)
    folder = Path(output)
    tell = progress or (lambda _: None)
    library = library or load_planned_library(plan, cache=cache, limits=limits)
    engine = replace(engine, require_confinement=limits.require_confinement)
    outline = Outline(plan)
    had_logs = (folder / LOGS_NAME).exists()
    with CocoDataset.open(folder) as dataset, _stop_on_signals() as stopping:
        interrupted = False
        session: Session | None = None
        try:
            session = Session(plan, outline, dataset, library, part=part, progress=tell)
            session.render(_make_pool(engine, require_path_inside(folder, LOGS_NAME), library, session, stopping))
        except Stopped:
            interrupted = True
            if session is not None and not session.begun:
                _undo_open_and_logs(dataset, keep_logs=had_logs)
        except HulldownError as error:
            if session is not None and session.begun:
                raise
            # A Blender that doesn't start reports the reason itself; reasons of failed attempts are in the log.
            logged = error.path is not None and Path(error.path).is_relative_to(folder / LOGS_NAME)
            started = session is not None and bool(session.made_by)
            keep_logs = had_logs or (logged and started)
            _undo_open_and_logs(dataset, keep_logs=keep_logs)
            if logged and not keep_logs:
                raise type(error)(error.problem, remedy=error.remedy) from error
            raise
        assert session is not None  # only a session is ever stopped
    return RenderReport(
        images=session.images,
        already=session.already,
        rendered=session.rendered,
        failed=tuple(session.failed),
        restarts=session.restarts,
        interrupted=interrupted,
        seconds=time.monotonic() - start,
    )


def _undo_open_and_logs(dataset: CocoDataset, *, keep_logs: bool) -> None:
    """Undo the opening of a dataset, so that the next run, perhaps of a corrected plan, finds it unchanged."""
    if not keep_logs:
        shutil.rmtree(dataset.folder / LOGS_NAME, ignore_errors=True)
    dataset.undo_open()


@contextlib.contextmanager
def _stop_on_signals() -> Iterator[Callable[[], bool]]:
    """On Ctrl-C or SIGTERM, end the run and its current pictures; the second signal doesn't wait."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop.is_set
        return

    def handle(number: int, _frame: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
