"""The oriented box of a label: the smallest rectangle around its visible mask."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from msgspec import Meta

from hulldown.annotate.label_type import LabeledVehicle, LabelType
from hulldown.annotate.labels.mask import VisibleMask
from hulldown.annotate.masks import encode_mask, run_starts_and_ends
from hulldown.annotate.record_fields import Pixel, Side
from hulldown.annotate.records import Category, Image, Label
from hulldown.annotate.rectangles import is_smallest_rectangle, rectangle_corners, smallest_mask_rectangle
from hulldown.base.errors import DatasetError

Rectangle = tuple[Pixel, Pixel, Side, Side, Pixel]  # center x, center y, width, height, and angle


class OrientedBox(LabelType):
    """The smallest rectangle around the visible mask."""

    obb: Annotated[
        Rectangle | None, Meta(description="smallest rectangle around the mask: [oriented boxes](labels.md#oriented-boxes)")
    ] = None

    @classmethod
    def compute_fields(cls, vehicle: LabeledVehicle) -> dict[str, object]:
        """Return the rectangle, rounded to 1e-6 pixels and 1e-9 radians; None for an empty mask."""
        if vehicle.traced is None:
            return {}
        mask = vehicle.traced.visible
        rectangle = smallest_mask_rectangle(encode_mask(mask), mask.shape[1], mask.shape[0])
        if rectangle is None:
            return {"obb": None}
        return {"obb": [*np.round(rectangle[:4], 6).tolist(), round(float(rectangle[4]), 9)]}

    def problems(self, label: Label, image: Image, category: Category | None) -> Iterator[str]:
        """Find a rectangle that isn't the smallest one around the mask."""
        given, mask = self.obb, label.read(VisibleMask).segmentation
        if given is None or not isinstance(mask, Mapping):
            return
        try:
            first, _ = run_starts_and_ends(mask, *image.size)
        except ValueError:
            return  # found by the mask's check
        if not len(first):
            return
        if not min(given[2:4]) > 0:
            yield f"obb {list(given)} has no area"
        elif not is_smallest_rectangle(given, mask, *image.size):
            yield f"obb {list(given)} isn't the smallest rectangle around its mask"


def visible_rectangle_corners(label: Label, image: Image) -> Float[np.ndarray, "4 2"]:
    """Return corners in pixels of a label's `obb`; without one, of its mask's rectangle; without a mask, of its box."""
    if (given := stored_rectangle(label)) is not None:
        return rectangle_corners(given)
    if mask := label.read(VisibleMask).segmentation:
        try:
            rectangle = smallest_mask_rectangle(mask, *image.size)
        except ValueError as error:
            problem, path = f"annotation {label.id}: {error}", Path(image.file_name)
            raise DatasetError(problem, path=path, remedy="check the dataset with `hulldown verify`") from None
        if rectangle is not None:
            return rectangle_corners(rectangle)
    x, y, w, h = label.bbox
    return rectangle_corners([x + w / 2, y + h / 2, w, h, 0.0])


def stored_rectangle(label: Label) -> Rectangle | None:
    """Return a label's `obb` if it has one with an area."""
    given = label.read(OrientedBox).obb
    return given if given is not None and min(given[2:4]) > 0 else None
