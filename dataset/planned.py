"""Does a dataset say what the plan that it was rendered from says? Row by row; a plan may be larger than memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import orjson

from dataset.records import Finding
from dataset.runs import Run, find_run, plan_key
from geometry.errors import DatasetError

# What goes from a plan's rows into a dataset, unchanged and in this order.
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
LABEL_KEYS = (
    "bbox",
    "vehicle",
    "world_from_vehicle",
    "articulation",
    "bbox_amodal",
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
        with plan.open("rb") as file:
            header = orjson.loads(file.readline())
        if "hulldown_plan" not in header:
            raise KeyError("hulldown_plan")
        planned, key = int(header["images"]), plan_key(plan)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise _no_plan(plan, error) from error
    run = find_run(coco, key)
    if run is None:
        yield Finding("error", plan.name, "nothing here was rendered from this file, as it is now")
        return
    names = {category["id"]: category.get("name") for category in coco["categories"]}
    images = {image["id"]: image for image in coco["images"] if run.has_image(image["id"])}
    boxes = {box["id"]: box for box in coco["annotations"] if run.has_annotation(box["id"])}
    first, missing, example = run.annotation_offset + 1, 0, ""
    for i, (name, wanted, targets) in enumerate(_rows(plan, run), start=run.image_offset + 1):
        image = images.get(i)
        if image is None:
            missing, example = missing + 1, example or name
        else:
            yield from _differ(name, image, wanted)
            for k, target in enumerate(targets, start=first):
                yield from _box_differs(name, boxes.pop(k, None), {"image_id": i, **target}, names)
        first += len(targets)
    # Left are those of images that are missing, and those that no row has.
    for box in boxes.values():
        if isinstance(i := box.get("image_id"), int) and i in images:
            name = str(images[i].get("file_name"))
            yield Finding("error", name, f"annotation {box['id']} has the id of one that is planned elsewhere")
    if missing:
        yield Finding("warning", plan.name, f"{missing} of {planned} planned images are not there, such as {example}")


def labelled(row: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """What the image of a row is labelled with: its target, and the companions of which something is seen."""
    return [row, *(c for c in row["companions"] if c["bbox"] is not None and c["visible_fraction"] > 0)]


def _rows(plan: Path, run: Run) -> Iterator[tuple[str, dict[str, Any], list[dict[str, Any]]]]:
    """Of each row its file name in the dataset, and what image and labels are to say."""
    try:
        with plan.open("rb") as file:
            file.readline()
            for row in map(orjson.loads, file):
                name = run.file_name(row["file_name"])
                labels = [{key: target[key] for key in ("category", *LABEL_KEYS)} for target in labelled(row)]
                yield name, {"file_name": name, **{key: row[key] for key in IMAGE_KEYS}}, labels
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise _no_plan(plan, error) from error


def _no_plan(plan: Path, error: Exception) -> DatasetError:
    return DatasetError(f"cannot be read as a plan ({error})", path=plan, remedy="name the plan's file")


def _box_differs(
    name: str, box: Mapping[str, Any] | None, wanted: Mapping[str, Any], names: Mapping[int, Any]
) -> Iterator[Finding]:
    what = f"{wanted['category']} {wanted['vehicle']!r}"
    if box is None:
        yield not_annotated(name, wanted)
        return
    label = box.get("category_id")
    found = {**box, "category": names.get(label) if isinstance(label, int) else None}
    for finding in _differ(name, found, wanted):
        yield Finding(finding.severity, name, f"{what}: {finding.problem}")


def not_annotated(name: str, target: Mapping[str, Any]) -> Finding:
    """A planned label is not there: a warning, since somebody may have deleted it on purpose."""
    return Finding("warning", name, f"{target['category']} {target['vehicle']!r} is planned and has no annotation")


def _differ(name: str, found: Mapping[str, Any], wanted: Mapping[str, Any]) -> Iterator[Finding]:
    for key, value in wanted.items():
        if found.get(key) != value:
            values = (repr(each)[:LONGEST] for each in (found.get(key), value))
            yield Finding("error", name, "{} is {}, planned is {}".format(key, *values))
