"""The oriented box of a label: the smallest rectangle around its visible mask."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hulldown.annotate.masks import encode, runs
from hulldown.annotate.rectangles import fits, mask_rectangle, rectangle_corners
from hulldown.base.errors import DatasetError
from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.labels.seen_vehicle import SeenVehicle


def seen_rectangle(vehicle: SeenVehicle) -> dict[str, object]:
    """Return the field of a vehicle's rectangle, rounded to 1e-6 pixels and 1e-9 radians."""
    height, width = vehicle.visible.shape
    rectangle = mask_rectangle(encode(vehicle.visible), width, height)
    if rectangle is None:
        return {"obb": None}
    return {"obb": [*np.round(rectangle[:4], 6).tolist(), round(float(rectangle[4]), 9)]}


def oriented_box_problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find a rectangle that isn't the smallest one around the mask."""
    given, mask = label.fields.obb, label.fields.segmentation
    if given is None or not isinstance(mask, Mapping):
        return
    try:
        first, _ = runs(mask, *image.size)
    except ValueError:
        return  # found by the mask's check
    if not len(first):
        return
    if not min(given[2:4]) > 0:
        yield f"obb {list(given)} has no area"
    elif not fits(given, mask, *image.size):
        yield f"obb {list(given)} isn't the smallest rectangle around its mask"


def visible_corners(label: Label, image: Image) -> Float[np.ndarray, "4 2"]:
    """Return corners in pixels of a label's `obb`; without one, of its mask's rectangle; without a mask, of its box."""
    if (given := rectangle_of(label)) is not None:
        return rectangle_corners(given)
    if mask := label.fields.segmentation:
        try:
            rectangle = mask_rectangle(mask, *image.size)
        except ValueError as error:
            problem, path = f"annotation {label.id}: {error}", Path(image.file_name)
            raise DatasetError(problem, path=path, remedy="check the dataset with `hulldown verify`") from None
        if rectangle is not None:
            return rectangle_corners(rectangle)
    x, y, w, h = label.bbox
    return rectangle_corners([x + w / 2, y + h / 2, w, h, 0.0])


def rectangle_of(label: Label) -> tuple[float, float, float, float, float] | None:
    """Return a label's `obb` if it has one with an area."""
    given = label.fields.obb
    return given if given is not None and min(given[2:4]) > 0 else None
