"""Compare a dataset with its plan, row by row; a plan may be larger than memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import orjson

from hulldown.assets.coco_types import Coco, Record
from hulldown.dataset.labels.types import fields_of_row
from hulldown.dataset.records import Finding
from hulldown.dataset.store.reservations import find_reservation, plan_key
from hulldown.planning.plan.row import PlannedVehicle, Row, encode, fields
from hulldown.planning.plan_file import Plan

IMAGE_KEYS = tuple(key for key, field in fields(Row).items() if field.recorded)
LABEL_KEYS = tuple(key for key, field in fields(PlannedVehicle).items() if field.recorded)
LONGEST = 120  # characters of a value in a finding


def check_planned(coco: Coco, plan: Plan) -> Iterator[Finding]:
    """Find differences between a plan's rows and their images and labels, and count missing ones.

    A difference is an error, since numbers are copied unrounded. A missing image is a warning, since a run may
    be in progress, or someone deleted it on purpose.
    """
    reservation = find_reservation(coco, plan_key(plan.path))
    if reservation is None:
        yield Finding("error", plan.path.name, "nothing here was rendered from this file, as it is now")
        return
    names = {category["id"]: category.get("name") for category in coco["categories"]}
    images = {image["id"]: image for image in coco["images"] if reservation.has_image(image["id"])}
    boxes = {box["id"]: box for box in coco["annotations"] if reservation.has_annotation(box["id"])}
    first, missing, example = reservation.annotation_offset + 1, 0, ""
    for i, row in enumerate(plan, start=reservation.image_offset + 1):
        image, name, labels = images.get(i), reservation.file_name(row.file_name), label_records(row)
        if image is None:
            missing, example = missing + 1, example or name
        else:
            yield from _differ(name, image, {"file_name": name, **image_record(row)})
            for k, label in enumerate(labels, start=first):
                yield from _box_differs(name, boxes.pop(k, None), {"image_id": i, **label}, names)
        first += len(labels)
    # Left are those of images that are missing, and those that no row has.
    for box in boxes.values():
        if isinstance(image_id := box.get("image_id"), int) and image_id in images:
            name = str(images[image_id].get("file_name"))
            yield Finding("error", name, f"annotation {box['id']} has the id of one that is planned elsewhere")
    if missing:
        problem = f"{missing} of {len(plan)} planned images are not there, such as {example}"
        yield Finding("warning", plan.path.name, problem)


def image_record(row: Row) -> Record:
    """Return a dataset's record of a row's image, without id and file name."""
    record = orjson.loads(encode(row))
    return {key: record[key] for key in IMAGE_KEYS if key in record}


def label_records(row: Row) -> list[Record]:
    """Return a dataset's records of a row's labeled vehicles, without ids and what needs the scene."""
    records: list[Record] = []
    for vehicle in row.labeled:
        encoded = orjson.loads(encode(vehicle))
        ignored = int(vehicle.label == "ignored")
        records.append(
            {
                **{key: encoded[key] for key in ("category", *LABEL_KEYS) if key in encoded},
                **fields_of_row(vehicle, row),
                "iscrowd": ignored,
            }
        )
    return records


def _box_differs(name: str, box: Record | None, wanted: Record, names: Mapping[int, Any]) -> Iterator[Finding]:
    if box is None:
        yield not_annotated(name, wanted["category"], wanted["vehicle"])
    else:
        label = box.get("category_id")
        recorded = {**box, "category": names.get(label) if isinstance(label, int) else None}
        yield from _differ(name, recorded, wanted, what=f"{wanted['category']} {wanted['vehicle']!r}: ")


def not_annotated(name: str, category: str | None, vehicle: str) -> Finding:
    """Return a warning about a missing label, which someone may have deleted on purpose."""
    return Finding("warning", name, f"{category} {vehicle!r} is planned and has no annotation")


def _differ(name: str, recorded: Record, wanted: Record, *, what: str = "") -> Iterator[Finding]:
    for key, value in wanted.items():
        if recorded.get(key) != value:
            values = (repr(each)[:LONGEST] for each in (recorded.get(key), value))
            yield Finding("error", name, "{}{} is {}, planned is {}".format(what, key, *values))
