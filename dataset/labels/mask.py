"""The mask of what is visible of a vehicle, as COCO's run lengths or polygons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float
from msgspec import Struct

from hulldown.annotate.masks import encode, extent
from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.labels.label_type import LabelType, SeenVehicle
from hulldown.dataset.store.declared import Side

OUTSIDE = 1.0  # pixels that a mask may reach beyond its box


class Fields(Struct):
    """The mask, in one of the forms that `annotate.masks.decode` checks, and its pixels."""

    segmentation: object = None
    area: Side | None = None


def _of_scene(vehicle: SeenVehicle) -> Fields:
    return Fields(encode(vehicle.visible), int(np.count_nonzero(vehicle.visible)))


def _problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find a damaged mask, one outside of its box, and another number of pixels."""
    fields = MASK.read(label)
    if not (mask := fields.segmentation):
        return
    try:
        pixels, box = extent(mask, *image.size)
    except ValueError as error:
        yield str(error)
        return
    yield from outside(label, box, "its mask")
    if isinstance(mask, Mapping) and fields.area is not None and fields.area != pixels:
        yield f"area is {label.record['area']}, its mask has {pixels} pixels"


def area_of(label: Label) -> float:
    """Return a label's area in pixels: that in its record, or without one its box's."""
    area = MASK.read(label).area
    return float(label.bbox[2] * label.bbox[3]) if area is None else area


def outside(label: Label, extent: Float[np.ndarray, "4"] | None, what: str) -> Iterator[str]:
    """Find a mask, by its extent as of `annotate.masks.extent`, that reaches out of the label's box."""
    if extent is None:
        return
    x, y, w, h = label.bbox
    low, high = extent[:2] - (x, y), extent[:2] + extent[2:] - (x + w, y + h)
    if low.min() < -OUTSIDE or high.max() > OUTSIDE:
        yield f"{what} covers {extent.tolist()}, beyond its bbox {label.record['bbox']}"


MASK = LabelType(Fields, _problems, of_scene=_of_scene)
