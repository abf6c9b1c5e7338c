"""A plan rendered into a dataset, unattended: worker processes, a journal line an image, no way out of the folder.

A row is finished once its picture has its final name and the journal has its line. Whatever happens before that costs
one picture; the next run does it again under the same name and id.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from annotate.coco import CocoDataset, Run
from geometry.errors import DatasetError
from planning.plan_file import Plan, is_inside, read_plan
from render.jobs import RenderAssets, job, render_assets, targets
from render.pool import DEFAULT_LIMITS, Limits, Pool, Stopped

FAILURES_NAME = "failures.jsonl"
LOGS_NAME = "logs"
UNFINISHED_NAME = ".unfinished"  # pictures being written; in the dataset, so that renaming never copies
POSE_KEYS = ("vehicle", "world_from_vehicle", "articulation", "visible_fraction", "truncated_fraction", "bbox_amodal")


@dataclass(frozen=True, slots=True)
class RenderReport:
    """How a run went.

    Parameters
    ----------
    images
        Images of the plan that were wanted.
    already
        Of these, how many were in the dataset before.
    rendered
        How many were added.
    failed
        File names of those that were given up; `failures.jsonl` has the reasons.
    restarts
        How often Blender had to be started again.
    interrupted
        Whether the run was stopped from outside before its end.
    seconds
        How long it took.
    """

    images: int
    already: int
    rendered: int
    failed: tuple[str, ...]
    restarts: int
    interrupted: bool
    seconds: float

    @property
    def complete(self) -> bool:
        """Whether every image that was wanted is in the dataset."""
        return self.already + self.rendered == self.images


@dataclass(frozen=True, slots=True)
class Progress:
    """What `render_plan` tells its caller now and then: pictures so far, and a line to show, or an empty one."""

    finished: int
    failed: int
    images: int
    line: str = ""


def render_plan(
    plan_path: Path | str,
    dataset_folder: Path | str,
    *,
    assets: RenderAssets | None = None,
    workers: int | None = None,
    device: str = "auto",
    limit: int | None = None,
    blender: str | None = None,
    limits: Limits = DEFAULT_LIMITS,
    progress: Callable[[Progress], None] | None = None,
) -> RenderReport:
    """Render what a plan plans and the dataset does not have yet.

    Parameters
    ----------
    plan_path
        The plan.
    dataset_folder
        Where to add images and annotations.
    assets
        The plan's files; those that its header names if not given.
    workers
        Processes that render; None for one a GPU, or one if there is none.
    device
        "auto", "cpu", "gpu", "optix", "cuda", "hip", "oneapi" or "metal".
    limit
        Only the first so many images of the plan.
    blender
        An installed Blender to use in place of the bpy module.
    limits
        Time, memory and attempts.
    progress
        Called after each image and with each message.

    Raises
    ------
    HulldownError
        If plan, assets or dataset cannot be used, or Blender does not work at all.
    """
    start = time.monotonic()
    plan = read_plan(plan_path)
    folder = Path(dataset_folder)
    say = progress or (lambda _: None)
    if assets is None:
        assets = render_assets(plan, progress=lambda path: say(Progress(0, 0, len(plan), f"reading {path}")))
    wanted = len(plan) if limit is None else min(limit, len(plan))
    with CocoDataset.open(folder, categories=_categories(plan)) as dataset, _stop_on_signals() as stopping:
        todo = _Todo(plan, dataset, wanted)
        session = _Session(plan, dataset, todo, assets, folder, say)
        with Pool(
            folder / LOGS_NAME,
            blender=blender,
            device=device,
            workers=workers,
            limits=limits,
            say=session.say,
            stopping=stopping,
        ) as pool:
            interrupted = False
            try:
                session.render(pool)
            except Stopped:
                interrupted = True
    return RenderReport(
        images=wanted,
        already=todo.already,
        rendered=session.rendered,
        failed=tuple(session.failed),
        restarts=pool.restarts,
        interrupted=interrupted,
        seconds=time.monotonic() - start,
    )


def _categories(plan: Plan) -> list[str]:
    return list(dict.fromkeys(vehicle["category"] for vehicle in plan.header["vehicles"].values()))


@contextlib.contextmanager
def _stop_on_signals() -> Iterator[Callable[[], bool]]:
    """Ctrl-C and a polite kill end the run between two pictures; a second Ctrl-C ends it at once."""
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


class _Todo:
    """Which rows are left, in the order that lets a worker keep what it has loaded."""

    def __init__(self, plan: Plan, dataset: CocoDataset, wanted: int) -> None:
        rows = [
            (row["scenery"], row["vehicle"], row["hdri"], row["index"], len(targets(row)), row["file_name"])
            for row in plan
        ]
        counts = np.array([row[4] for row in rows], dtype=np.int64)
        key = hashlib.sha256(plan.path.read_bytes()).hexdigest()
        self.run: Run = dataset.run(key, images=len(rows), annotations=int(counts.sum()))
        # Ids depend on the plan alone, never on the order in which pictures are finished.
        self.first_annotation = np.concatenate([[0], np.cumsum(counts)[:-1]]) + self.run.annotation_offset + 1
        left = [row for row in rows[:wanted] if not dataset.finished(self.run.file_name(row[5]))]
        self.already = min(wanted, len(rows)) - len(left)
        self.order = [row[3] for row in sorted(left)]
        self.vehicles = plan.header["vehicles"]


class _Session:
    """What happens to the rows of one run."""

    def __init__(
        self,
        plan: Plan,
        dataset: CocoDataset,
        todo: _Todo,
        assets: RenderAssets,
        folder: Path,
        progress: Callable[[Progress], None],
    ) -> None:
        self.plan, self.dataset, self.todo, self.assets = plan, dataset, todo, assets
        self.folder = folder
        self.rendered = 0
        self.failed: list[str] = []
        self._progress = progress
        self._unfinished = folder / UNFINISHED_NAME
        self._settings = {
            key: plan.header["config"]["render"][key] for key in ("samples", "denoise", "adaptive_threshold", "bounces")
        }

    def say(self, line: str) -> None:
        self._progress(Progress(self.todo.already + self.rendered, len(self.failed), len(self.todo.order), line))

    def render(self, pool: Pool) -> None:
        shutil.rmtree(self._unfinished, ignore_errors=True)
        self._unfinished.mkdir()
        (self.folder / FAILURES_NAME).unlink(missing_ok=True)
        try:
            pool.run(self.todo.order, self._message, self._done, self._give_up)
        finally:
            shutil.rmtree(self._unfinished, ignore_errors=True)

    def _file_name(self, row: Mapping[str, Any]) -> str:
        return self.todo.run.file_name(row["file_name"])

    def _output(self, index: int, row: Mapping[str, Any]) -> Path:
        return self._unfinished.resolve() / f"{index}{Path(row['file_name']).suffix.lower()}"

    def _message(self, index: int) -> dict[str, Any]:
        row = self.plan[index]
        return job(row, self.assets, self._settings, self._output(index, row))

    def _done(self, index: int, _answer: Mapping[str, Any]) -> None:
        row = self.plan[index]
        name = self._file_name(row)
        publish(self._output(index, row), self.folder, name)
        run = self.todo.run
        image = {
            "id": run.image_offset + index + 1,
            "file_name": name,
            "width": row["width"],
            "height": row["height"],
            **{key: row[key] for key in ("scenery", "hdri", "hdri_yaw_deg", "strength", "weather", "position", "shot")},
            "world_from_camera": row["world_from_camera"],
            "fov_x_deg": row["fov_x_deg"],
        }
        first = int(self.todo.first_annotation[index])
        annotations = [
            {"id": first + i, "category": t["category"], "bbox": t["bbox"], **{k: t[k] for k in POSE_KEYS}}
            for i, t in enumerate(targets(row))
        ]
        self.dataset.append(image, annotations)
        self.rendered += 1
        self.say("")

    def _give_up(self, index: int, reasons: list[str]) -> None:
        name = self._file_name(self.plan[index])
        with (self.folder / FAILURES_NAME).open("ab") as file:
            file.write(
                orjson.dumps({"index": index, "file_name": name, "reasons": reasons}, option=orjson.OPT_APPEND_NEWLINE)
            )
            file.flush()
            os.fsync(file.fileno())
        self.failed.append(name)
        self.say(f"{name}: given up after {len(reasons)} attempts: {reasons[-1]}")


def publish(picture: Path, folder: Path, name: str) -> None:
    """Give a finished picture its name in the dataset, in one step and never outside the folder.

    Raises
    ------
    DatasetError
        If the name leads out of the folder, also by way of a symbolic link.
    """
    if not is_inside(name):
        raise DatasetError(f"file_name {name!r} leaves the dataset's folder", path=folder)
    final = folder / name
    final.parent.mkdir(parents=True, exist_ok=True)
    if not final.parent.resolve().is_relative_to(folder.resolve()):
        raise DatasetError(
            f"{name}: its folder is a link to {final.parent.resolve()}",
            path=folder,
            remedy="replace the link by a folder, or put the whole dataset there",
        )
    with picture.open("rb") as file:
        os.fsync(file.fileno())
    os.replace(picture, final)
    if sys.platform != "win32":
        handle = os.open(final.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
