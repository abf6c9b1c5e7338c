"""The oriented box of a label: the smallest rectangle around its visible mask."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from jaxtyping import Float
from msgspec import Struct

from hulldown.annotate.masks import encode, runs
from hulldown.annotate.rectangles import fits, mask_rectangle, rectangle_corners
from hulldown.assets.coco_types import Record
from hulldown.base.errors import DatasetError
from hulldown.dataset.labels.label_type import LabelType, SeenVehicle
from hulldown.dataset.store.declared import Pixel, Side
from hulldown.dataset.store.entries import is_list_of_numbers


class Fields(Struct):
    """Center, width, height in pixels, and the angle of the width in radians."""

    obb: tuple[Pixel, Pixel, Side, Side, Pixel] | None = None


def _of_scene(vehicle: SeenVehicle) -> dict[str, Any]:
    """`annotate.rectangles.mask_rectangle`, rounded to 1e-6 pixels and 1e-9 radians."""
    height, width = vehicle.visible.shape
    rectangle = mask_rectangle(encode(vehicle.visible), width, height)
    if rectangle is None:
        return {"obb": None}
    return {"obb": [*np.round(rectangle[:4], 6).tolist(), round(float(rectangle[4]), 9)]}


def _problems(label: Record, image: Record, category: Record) -> Iterator[str]:
    """Find a rectangle that isn't the smallest one around the mask."""
    given, mask = label.get("obb"), label.get("segmentation")
    if given is None or not isinstance(mask, Mapping):
        return
    try:
        first, _ = runs(mask, image["width"], image["height"])
    except ValueError:
        return  # found by the mask's check
    if not len(first):
        return
    if not is_rectangle(given):
        yield f"obb {given!r} is not [x, y, width, height, angle]"
    elif not fits(given, mask, image["width"], image["height"]):
        yield f"obb {given!r} isn't the smallest rectangle around its mask"


def visible_corners(label: Record, image: Record) -> Float[np.ndarray, "4 2"]:
    """Return corners in pixels of a label's `obb`; without one, of its mask's rectangle; without a mask, of its box.

    Raises
    ------
    DatasetError
        If the mask is damaged.
    """
    if is_rectangle(given := label.get("obb")):
        return rectangle_corners(given)
    if label.get("segmentation"):
        try:
            rectangle = mask_rectangle(label["segmentation"], image["width"], image["height"])
        except ValueError as error:
            problem, path = f"annotation {label['id']}: {error}", Path(str(image["file_name"]))
            raise DatasetError(problem, path=path, remedy="check the dataset with `hulldown verify`") from None
        if rectangle is not None:
            return rectangle_corners(rectangle)
    x, y, w, h = label["bbox"]
    return rectangle_corners([x + w / 2, y + h / 2, w, h, 0.0])


def is_rectangle(value: Any) -> TypeGuard[list[float]]:
    """Return whether this is [center x, center y, width, height, angle], finite and with an area."""
    return is_list_of_numbers(value) and len(value) == 5 and bool(min(value[2:4]) > 0)


ORIENTED_BOX = LabelType(Fields, _problems, of_scene=_of_scene)
