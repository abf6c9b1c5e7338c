"""Compare a dataset's annotations with Cycles' own masks."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8
from rich.markup import escape
from rich.table import Table

from hulldown.annotate.labels.mask import AmodalMask, VisibleMask
from hulldown.annotate.masks import decode_mask, mask_box, mask_iou
from hulldown.annotate.records import Label
from hulldown.base.arguments import AnyPath
from hulldown.base.errors import DatasetError, HulldownError
from hulldown.base.indices import even_sample
from hulldown.base.terminal import track_items
from hulldown.dataset.record_checks import Finding, sound_images_by_id
from hulldown.dataset.store.document import read_coco
from hulldown.dataset.store.reservations import find_reservation
from hulldown.dataset.verification.check_plan import missing_label_finding
from hulldown.plan.library import Library
from hulldown.plan.plan_file import Plan, read_plan
from hulldown.render.blender.messages import MaskJob
from hulldown.render.jobs import blender_readable_paths, make_mask_job
from hulldown.render.outline import Outline
from hulldown.render.pool import Engine, Pool
from hulldown.render.process import Confinement

MAX_BOX_DIFFERENCE_PX = 1.0  # between a box and a mask's box, whose sides are between pixel centers
MIN_EQUAL_IOU = 0.99  # of masks that are equal up to float32 at their edges
MAX_SMALL_DIFFERENCE_PX = 2  # of masks so small that one pixel exceeds the IoU's limit


@dataclass(frozen=True, slots=True)
class MaskRow:
    """An annotation compared with Cycles' masks."""

    file_name: str  # file_name, vehicle: the image and the vehicle
    vehicle: str
    pixels: int  # pixels of the rendered visible mask
    # largest distance of the annotated box's sides from those of the whole rendered vehicle, in pixels; inf if it has
    # no pixel
    box_error: float
    outside: float  # pixels that the rendered vehicle reaches beyond the annotated box
    # mask_iou, amodal_iou: overlap of annotated and rendered masks, visible and whole; nan where the annotation has
    # none
    mask_iou: float
    amodal_iou: float


@dataclass(frozen=True, slots=True)
class MaskReport:
    """The measurements of `verify_masks`, and the findings."""

    rows: tuple[MaskRow, ...]
    findings: tuple[Finding, ...]

    def table(self) -> Table:
        """Return a row for each annotation."""
        table = Table(title="annotations against masks rendered by Cycles", title_justify="left")
        for column in ("image", "vehicle", "pixels", "box error (px)", "mask IoU"):
            table.add_column(column, justify="left" if column in ("image", "vehicle") else "right")
        for row in self.rows:
            numbers = (f"{row.pixels:,}", f"{row.box_error:.2f}", f"{row.mask_iou:.4f}")
            table.add_row(escape(row.file_name), escape(row.vehicle), *numbers)
        return table


def verify_masks(dataset: Path, plan_path: AnyPath, library: Library, *, count: int) -> MaskReport:
    """Render the masks of some images of a dataset, and compare its annotations with them."""
    plan = read_plan(plan_path)
    coco = read_coco(dataset)
    outline = Outline(plan)
    reservation = find_reservation(coco, outline.key)
    if reservation is None:
        raise DatasetError(f"has no images of {plan.path}", path=dataset, remedy="name the plan it was rendered from")
    names = {number: image.file_name for number, image in sound_images_by_id(coco).items()}
    finished = [i for i in range(len(plan)) if reservation.image_offset + i + 1 in names]
    chosen = [finished[i] for i in even_sample(len(finished), count)]
    labels = {label["id"]: label for label in coco["annotations"] if reservation.has_annotation_id(label["id"])}
    first = outline.first_annotation_ids(reservation)
    maps = render_index_maps_of_rows(plan, chosen, library)
    rows: list[MaskRow] = []
    findings: list[Finding] = []
    for index, of_row in zip(chosen, maps, strict=True):
        image_id, row = reservation.image_offset + index + 1, plan[index]
        numbers = [(number, each) for number, each in enumerate(row.vehicles, start=1) if each.label != "none"]
        for label_id, (number, target) in enumerate(numbers, start=int(first[index])):
            record = labels.get(label_id)
            if record is None or record.get("image_id") != image_id:
                findings.append(missing_label_finding(names[image_id], target.category, target.vehicle))
                continue
            try:
                label, alone, visible = Label.from_record(record, {}), of_row[number] == number, of_row[0] == number
                measured = compare_label_with_masks(names[image_id], target.vehicle, label, alone, visible)
            except ValueError as error:
                where = f"{names[image_id]}, {target.vehicle}"
                problem = f"annotation {label_id} cannot be held against a mask: {error}"
                findings.append(Finding("error", where, problem))
                continue
            rows.append(measured)
            findings += [finding] if (finding := _mask_finding(measured, label.read(VisibleMask).area or 0.0)) else []
    return MaskReport(tuple(rows), tuple(findings))


def compare_label_with_masks(
    name: str, vehicle: str, label: Label, alone: Bool[np.ndarray, "h w"], visible: Bool[np.ndarray, "h w"]
) -> MaskRow:
    """Compare a label with masks of its vehicle alone and with its occluders."""
    box_error, outside, rendered = math.inf, 0.0, mask_box(alone)
    if rendered is not None:
        box = label.bbox
        beyond = np.append(box[:2] - rendered[:2], (rendered[:2] + rendered[2:]) - (box[:2] + box[2:]))
        box_error, outside = float(np.abs(beyond).max()), float(max(beyond.max(), 0.0))
    height, width = visible.shape
    overlaps = [
        mask_iou(decode_mask(mask, width, height), shown) if mask else math.nan
        for mask, shown in (
            (label.read(VisibleMask).segmentation, visible),
            (label.read(AmodalMask).segmentation_amodal, alone),
        )
    ]
    return MaskRow(name, vehicle, int(visible.sum()), box_error, outside, *overlaps)


def _mask_finding(row: MaskRow, annotated: float) -> Finding | None:
    where = f"{row.file_name}, {row.vehicle}"
    if row.outside > MAX_BOX_DIFFERENCE_PX:
        return Finding("error", where, f"reaches {row.outside:.1f} px out of its box in Cycles' mask")
    for overlap, what in ((row.mask_iou, "mask"), (row.amodal_iou, "amodal mask")):
        if overlap < MIN_EQUAL_IOU and (1 - overlap) * max(annotated, row.pixels) > MAX_SMALL_DIFFERENCE_PX:
            return Finding("error", where, f"annotated and rendered {what} overlap by {overlap:.3f} only")
    if row.box_error > MAX_BOX_DIFFERENCE_PX:
        return Finding(
            "warning", where, f"box is {row.box_error:.1f} px larger than Cycles' mask: a detail thinner than a pixel"
        )
    return None


def render_index_maps_of_rows(plan: Plan, rows: Sequence[int], library: Library) -> list[UInt8[np.ndarray, "_ h w"]]:
    """Render the masks of all vehicles in some rows of a plan, for each row as by `IndexPictures.render_vehicle_index_maps`."""
    maps: dict[int, UInt8[np.ndarray, "_ h w"]] = {}
    with tempfile.TemporaryDirectory(prefix="hulldown-") as name:
        folder = Path(name)

        def job(index: int) -> MaskJob:
            return make_mask_job(plan[index], library, folder / f"{index}.npy")

        confinement = Confinement(folder, blender_readable_paths(library))
        with Pool(folder / "logs", Engine(workers=1), confinement=confinement) as pool:
            results = pool.results(sorted(rows, key=lambda i: plan[i].scenery), job)
            for index, outcome in track_items("rendering masks", results, len(rows)):
                if outcome.reasons:
                    problem = f"the mask of image {index} cannot be rendered: {outcome.reasons[-1]}"
                    raise HulldownError(problem, path=plan.path)
                maps[index] = np.load(io.BytesIO(outcome.content))
    return [maps[index] for index in rows]
