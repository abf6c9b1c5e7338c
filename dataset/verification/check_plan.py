"""Compare a dataset with its plan, row by row, and its labels with those of the rows' scenes, computed anew."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from hulldown.annotate.coco_types import Coco, Record
from hulldown.annotate.masks import decode_mask
from hulldown.base.errors import HulldownError
from hulldown.dataset.record_checks import Finding
from hulldown.dataset.row_records import Segmenter, planned_label_records, recorded_image_fields
from hulldown.dataset.store.reservations import find_reservation, plan_file_key
from hulldown.plan.library import Library
from hulldown.plan.plan_file import Plan

MAX_RECORD_VALUE_CHARACTERS = 120  # in a finding
MASK_FIELDS = ("segmentation", "segmentation_amodal")
OF_MASKS = (*MASK_FIELDS, "area", "obb")  # fields that follow from masks; `dataset.record_checks` compares them with each other
MAX_MASK_DIFFERENCE_PX = 2  # on another kind of processor, rays on an edge may fall on its other side


def find_plan_differences(coco: Coco, plan: Plan, assets: Callable[[], Library] | None) -> Iterator[Finding]:
    """Find images and labels that differ from a plan's rows (errors), and missing ones (warnings)."""
    reservation = find_reservation(coco, plan_file_key(plan.path))
    if reservation is None:
        yield Finding("error", plan.path.name, "nothing here was rendered from this file, as it is now")
        return
    records = planned_label_records
    try:
        records = records if assets is None else Segmenter.of_plan(plan, assets()).label_records_with_masks
    except HulldownError as error:
        yield Finding("warning", plan.path.name, f"labels that need the scene are not compared: {error}")
    names = {category["id"]: category.get("name") for category in coco["categories"]}
    images = {image["id"]: image for image in coco["images"] if reservation.has_image_id(image["id"])}
    boxes = {box["id"]: box for box in coco["annotations"] if reservation.has_annotation_id(box["id"])}
    first, missing, example = reservation.annotation_offset + 1, 0, ""
    for i, row in enumerate(plan, start=reservation.image_offset + 1):
        image, name = images.get(i), reservation.dataset_file_name(row.file_name)
        if image is None:
            missing, example = missing + 1, example or name
            first += len(row.labeled)
            continue
        yield from _differing_field_findings(name, image, {"file_name": name, **recorded_image_fields(row)})
        for number, label in enumerate(records(row), start=first):
            yield from _label_findings(name, boxes.pop(number, None), {"image_id": i, **label}, names)
        first += len(row.labeled)
    # Left are those of images that are missing, and those that no row has.
    for box in boxes.values():
        if isinstance(image_id := box.get("image_id"), int) and image_id in images:
            name = str(images[image_id].get("file_name"))
            yield Finding("error", name, f"annotation {box['id']} has the id of one that is planned elsewhere")
    if missing:
        problem = f"{missing} of {len(plan)} planned images are not there, such as {example}"
        yield Finding("warning", plan.path.name, problem)


def missing_label_finding(name: str, category: str | None, vehicle: str) -> Finding:
    """Return the finding of a missing label."""
    return Finding("error", name, f"{category} {vehicle!r} is planned and has no annotation")


def _label_findings(name: str, box: Record | None, wanted: Record, names: Mapping[int, Any]) -> Iterator[Finding]:
    if box is None:
        yield missing_label_finding(name, wanted["category"], wanted["vehicle"])
        return
    label = box.get("category_id")
    recorded = {**box, "category": names.get(label) if isinstance(label, int) else None}
    if all(_is_nearly_same_mask(recorded.get(key), wanted.get(key)) for key in MASK_FIELDS):
        wanted = {key: value for key, value in wanted.items() if key not in OF_MASKS}
    yield from _differing_field_findings(name, recorded, wanted, what=f"{wanted['category']} {wanted['vehicle']!r}: ")


def _is_nearly_same_mask(recorded: object, wanted: object) -> bool:
    if recorded == wanted or not isinstance(wanted, Mapping):
        return recorded == wanted
    height, width = wanted["size"]
    try:
        differ = decode_mask(recorded, width, height) != decode_mask(wanted, width, height)
    except ValueError:
        return False
    return bool(np.count_nonzero(differ) <= MAX_MASK_DIFFERENCE_PX)


def _differing_field_findings(name: str, recorded: Record, wanted: Record, *, what: str = "") -> Iterator[Finding]:
    for key, value in wanted.items():
        if recorded.get(key) != value:
            values = (repr(each)[:MAX_RECORD_VALUE_CHARACTERS] for each in (recorded.get(key), value))
            yield Finding("error", name, "{}{} is {}, planned is {}".format(what, key, *values))
