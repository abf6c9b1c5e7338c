"""One run of a plan; a row is finished when its picture has its final name and the journal has its line."""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hulldown.annotate.record_fields import PICTURE_HASH_KEY
from hulldown.base.errors import ConfigError, HulldownError
from hulldown.base.outputs import UNFINISHED_NAME
from hulldown.dataset.coco import LOGS_NAME, CocoDataset
from hulldown.dataset.provenance import (
    Failure,
    Provenance,
    add_provenance,
    read_failures,
    read_provenance_by_plan,
    write_failures,
)
from hulldown.dataset.row_records import Segmenter, plan_category_records, recorded_image_fields
from hulldown.dataset.store.placed_pictures import explain_picture_write_errors, move_picture_to_dataset, require_path_inside
from hulldown.plan.library import Library
from hulldown.plan.plan_file import Plan
from hulldown.plan.row import Row
from hulldown.render.blender.messages import RenderJob
from hulldown.render.jobs import make_planned_row_job
from hulldown.render.outline import Outline, Part, file_stamp
from hulldown.render.pool import Pool
from hulldown.render.process import Outcome, png_without_notes

if TYPE_CHECKING:
    from hulldown.render.cluster_pool import ClusterPool

MAX_FAILURES_IN_A_ROW = 30  # over all images; more aren't the images' fault


@dataclass(frozen=True, slots=True)
class RenderProgress:
    """A run's numbers of finished, failed, and wanted pictures, its workers, and a message, possibly empty."""

    finished: int
    failed: int
    images: int
    line: str = ""
    workers: int = 0


class Session:
    """Sends rows to a pool, and stores its results."""

    def __init__(
        self,
        plan: Plan,
        outline: Outline,
        dataset: CocoDataset,
        library: Library,
        *,
        part: Part,
        progress: Callable[[RenderProgress], None],
    ) -> None:
        self.rendered = self.restarts = self._failed_in_a_row = 0
        self.failed: list[str] = []
        self.begun = False
        self.made_by: dict[str, list[str]] = {}
        self._plan, self._plan_stamp, self._dataset, self._library = plan, outline.stamp, dataset, library
        self._segmenter = Segmenter.of_plan(plan, library)
        dataset.add_categories(plan_category_records(plan, library.shapes), keypoints=True)
        reservation = self._reservation = dataset.reserve_ids(
            outline.key, images=len(outline.rows), annotations=int(outline.labels.sum())
        )
        rows, firsts = part.part_rows(outline), outline.first_annotation_ids(reservation).tolist()
        self._pending_images: dict[int, tuple[str, int]] = {}  # index -> name in the dataset, and id of the first label
        for _, index, labels, planned in rows:
            if not dataset.finished(name := reservation.dataset_file_name(planned)):
                self._pending_images[index] = name, firsts[index]
                of_labels = range(firsts[index], firsts[index] + labels)
                dataset.refuse_taken_ids(name, reservation.image_offset + index + 1, of_labels)
        names = {name for name, _ in self._pending_images.values()}
        self.images, self.already = len(rows), len(rows) - len(self._pending_images)
        self._progress = progress
        self._pool: Pool | ClusterPool | None = None
        self._folder = dataset.folder
        self.unfinished = require_path_inside(self._folder, UNFINISHED_NAME).absolute()
        # Failures of other plans, and of images outside this run. Damage is found before Blender starts.
        self._failures = [failure for failure in read_failures(self._folder) if failure.file_name not in names]
        read_provenance_by_plan(self._folder)
        self._recorded: dict[str, list[str]] = {}

    def report_progress(self, line: str) -> None:
        """Report progress to the caller."""
        workers = self._pool.working if self._pool else 0
        self._progress(RenderProgress(self.already + self.rendered, len(self.failed), self.images, line, workers))

    def render(self, pool: Pool | ClusterPool) -> None:
        """Render the remaining rows, and end the pool; errors as for `render.pool.Pool.results`."""
        if self.unfinished.is_symlink() or self.unfinished.is_file():
            self.unfinished.unlink()  # not a link's target
        for wait in (0.1, 0.5, 2.0, 0.0):
            shutil.rmtree(self.unfinished, ignore_errors=True)
            if not wait or not self.unfinished.exists():
                break
            time.sleep(wait)  # the Blender of a run that was just killed may write a picture before it ends, too
        self.unfinished.mkdir()
        self._pool = pool
        self.report_progress("")
        try:
            with pool:
                for index, outcome in pool.results(list(self._pending_images), self._make_job):
                    self._store_outcome(index, outcome)
            if self.failed:
                self._write_failures_once()
        finally:  # after the pool's end, until which Blenders write
            shutil.rmtree(self.unfinished, ignore_errors=True)

    def _store_outcome(self, index: int, outcome: Outcome) -> None:
        self.restarts += outcome.restarts
        news = {name: sorted({*self.made_by.get(name, ()), value}) for name, value in outcome.made_by.items()}
        self.made_by = {**self.made_by, **news}
        if not outcome.reasons:
            self._store_picture_and_labels(index, outcome)
            self._failed_in_a_row = 0
            return
        self._set_image_aside(index, outcome.reasons)
        self._failed_in_a_row += len(outcome.reasons)
        if self._failed_in_a_row >= MAX_FAILURES_IN_A_ROW:
            raise HulldownError(
                f"{self._failed_in_a_row} attempts have failed one after the other, the last with: {outcome.reasons[-1]}",
                path=logs if (logs := self._folder / LOGS_NAME).is_dir() else self._folder,
                remedy="fix the cause and run again, which goes on from here",
            )

    def _write_failures_once(self) -> None:
        if not self.begun:
            self.begun = True
            write_failures(self._folder, self._failures)

    def _record_provenance(self) -> None:
        if self.made_by == self._recorded:
            return
        made = Provenance(
            file=self._plan.path.name,
            first_image_id=self._reservation.image_offset + 1,
            images=len(self._plan),
            **self.made_by,
            plan=self._plan.header,
        )
        add_provenance(self._folder, {self._reservation.key: made})
        self._recorded = self.made_by

    def _output_path(self, row: Row) -> Path:
        return self.unfinished / f"{row.index}.png"

    def _read_row(self, index: int) -> Row:
        """Return a row of the plan, read when needed; refused if the plan's file was replaced meanwhile."""
        if file_stamp(self._plan.path) != self._plan_stamp:
            raise ConfigError(
                "is not what it was when this run began",
                path=self._plan.path,
                remedy="run again; a new plan is better planned to a new file and rendered into a new folder",
            )
        return self._plan[index]

    def _make_job(self, index: int) -> RenderJob:
        row = self._read_row(index)
        return make_planned_row_job(self._plan, row, self._library, self._output_path(row))

    def _store_picture_and_labels(self, index: int, outcome: Outcome) -> None:
        row = self._read_row(index)
        picture = self._output_path(row)
        name, first = self._pending_images[index]
        records = self._segmenter.label_records_with_masks(row)
        self._write_failures_once()
        self._record_provenance()
        content = png_without_notes(outcome.content)
        with explain_picture_write_errors(self._folder, name):
            picture.write_bytes(content)
        move_picture_to_dataset(picture, self._folder, name)
        image_id = self._reservation.image_offset + index + 1
        about = {"id": image_id, "file_name": name, "device": outcome.made_by["devices"]}
        self._dataset.append(
            {**about, PICTURE_HASH_KEY: hashlib.sha256(content).hexdigest(), **recorded_image_fields(row)},
            [{"id": first + i, **record} for i, record in enumerate(records)],
        )
        self.rendered += 1
        self.report_progress("")

    def _set_image_aside(self, index: int, reasons: Sequence[str]) -> None:
        name, _ = self._pending_images[index]
        self._failures.append(Failure(index=index, file_name=name, reasons=list(reasons)))
        if self.begun:
            write_failures(self._folder, self._failures)
        self.failed.append(name)
        self.report_progress(f"{name}: given up after {len(reasons)} attempts: {reasons[-1]}")
