"""Does a dataset say what the plan that it was rendered from says? Row by row; a plan may be larger than memory."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import orjson

from annotate.records import Finding
from annotate.runs import Run
from geometry.errors import DatasetError

IMAGE_KEYS = (
    "width",
    "height",
    "scenery",
    "position",
    "shot",
    "world_from_camera",
    "fov_x_deg",
    "hdri",
    "hdri_yaw_deg",
    "strength",
    "weather",
    "sample_seed",
)
TARGET_KEYS = (
    "bbox",
    "bbox_amodal",
    "vehicle",
    "world_from_vehicle",
    "articulation",
    "visible_fraction",
    "truncated_fraction",
)
LONGEST = 120  # characters of a value in a finding


def check_planned(coco: Mapping[str, Any], plan: Path) -> Iterator[Finding]:
    """Where images of a plan and their labels differ from its rows, and how many are not there.

    A difference is an error: numbers go from plan to dataset unrounded. What is missing is a warning, since a run may
    be under way, and somebody may have deleted it on purpose.

    Parameters
    ----------
    coco
        The dataset.
    plan
        The plan's file, the same to the byte as when it was rendered.

    Raises
    ------
    DatasetError
        If the file is no plan.
    """
    try:
        key, header = _identity(plan)
        runs = coco["info"].get("hulldown_runs", []) if isinstance(coco.get("info"), dict) else []
        run = next((Run(**record) for record in runs if record["key"] == key), None)
        if run is None:
            yield Finding("error", plan.name, "nothing here was rendered from this file, as it is now")
            return
        yield from _differences(coco, plan, run, int(header["images"]))
    except (OSError, StopIteration, orjson.JSONDecodeError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"cannot be read as a plan ({error})", path=plan, remedy="name the plan's file") from error


def _identity(plan: Path) -> tuple[str, dict[str, Any]]:
    with plan.open("rb") as file:
        header = orjson.loads(next(file))
        if "hulldown_plan" not in header:
            raise KeyError("hulldown_plan")
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest(), header


def _differences(coco: Mapping[str, Any], plan: Path, run: Run, planned: int) -> Iterator[Finding]:
    names = {category["id"]: category.get("name") for category in coco["categories"]}
    images = {image["id"]: image for image in coco["images"] if run.has_image(image["id"])}
    boxes = {box["id"]: box for box in coco["annotations"] if run.has_annotation(box["id"])}
    first, missing, example = run.annotation_offset + 1, 0, ""
    with plan.open("rb") as file:
        next(file)
        for i, row in enumerate(map(orjson.loads, file), start=run.image_offset + 1):
            # What is wholly hidden or out of the picture gets no label.
            seen = [c for c in row["companions"] if c["bbox"] is not None and c["visible_fraction"] > 0]
            name = run.file_name(row["file_name"])
            image = images.get(i)
            if image is None:
                missing, example = missing + 1, example or name
            else:
                yield from _differ(name, image, {**row, "file_name": name}, ("file_name", *IMAGE_KEYS))
                for k, target in enumerate((row, *seen), start=first):
                    yield from _box_differs(name, boxes.pop(k, None), target, i, names)
            first += 1 + len(seen)
    # Left are those of images that are missing, and those that no row has.
    for box in boxes.values():
        if box.get("image_id") in images:
            name = images[box["image_id"]].get("file_name")
            yield Finding("error", str(name), f"annotation {box['id']} has the id of one that is planned elsewhere")
    if missing:
        yield Finding("warning", plan.name, f"{missing} of {planned} planned images are not there, such as {example}")


def _box_differs(
    name: str, box: Mapping[str, Any] | None, target: Mapping[str, Any], image_id: int, names: Mapping[int, Any]
) -> Iterator[Finding]:
    what = f"{target['category']} {target['vehicle']!r}"
    if box is None:
        yield Finding("warning", name, f"{what} is planned and has no annotation")
        return
    label = box.get("category_id")
    found = {**box, "category": names.get(label) if isinstance(label, int) else None}
    wanted = {**target, "image_id": image_id}
    for finding in _differ(name, found, wanted, ("image_id", "category", *TARGET_KEYS)):
        yield Finding(finding.severity, name, f"{what}: {finding.problem}")


def _differ(name: str, found: Mapping[str, Any], wanted: Mapping[str, Any], keys: tuple[str, ...]) -> Iterator[Finding]:
    for key in keys:
        if found.get(key) != wanted[key]:
            values = (repr(value)[:LONGEST] for value in (found.get(key), wanted[key]))
            yield Finding("error", name, "{} is {}, planned is {}".format(key, *values))
