"""Masks of what is visible of a vehicle, as COCO's run lengths or polygons, and of the whole vehicle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float

from hulldown.annotate.masks import covers, encode, extent
from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.labels.seen_vehicle import SeenVehicle

MAX_OVERHANG_PX = 1.0  # pixels that a mask may reach beyond its box


def seen_masks(vehicle: SeenVehicle) -> dict[str, object]:
    """Return the fields of a vehicle's masks."""
    visible, pixels = encode(vehicle.visible), int(np.count_nonzero(vehicle.visible))
    return {"segmentation": visible, "area": pixels, "segmentation_amodal": encode(vehicle.whole)}


def area_of(label: Label) -> float:
    """Return a label's area in pixels: that in its record, or without one its box's."""
    area = label.fields.area
    return float(label.bbox[2] * label.bbox[3]) if area is None else area


def mask_problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find a damaged mask, one outside of its box, and another number of pixels."""
    mask, area = label.fields.segmentation, label.fields.area
    if not mask:
        return
    try:
        pixels, box = extent(mask, *image.size)
    except ValueError as error:
        yield str(error)
        return
    yield from _outside(label, box, "its mask")
    if isinstance(mask, Mapping) and area is not None and area != pixels:
        yield f"area is {label.record['area']}, its mask has {pixels} pixels"


def amodal_mask_problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find a damaged amodal mask, one outside of the box, and one that lacks visible pixels."""
    if (whole := label.fields.segmentation_amodal) is None:
        return
    try:
        _, box = extent(whole, *image.size)
    except ValueError as error:
        yield f"segmentation_amodal: {error}"
        return
    yield from _outside(label, box, "its amodal mask")
    try:
        if (visible := label.fields.segmentation) and not covers(whole, visible, *image.size):
            yield "its amodal mask lacks pixels of its mask"
    except ValueError:
        return  # the visible mask is damaged, which is found there


def _outside(label: Label, extent: Float[np.ndarray, "4"] | None, what: str) -> Iterator[str]:
    """Find a mask, by its extent as of `annotate.masks.extent`, that reaches out of the label's box."""
    if extent is None:
        return
    x, y, w, h = label.bbox
    low, high = extent[:2] - (x, y), extent[:2] + extent[2:] - (x + w, y + h)
    if low.min() < -MAX_OVERHANG_PX or high.max() > MAX_OVERHANG_PX:
        yield f"{what} covers {extent.tolist()}, beyond its bbox {label.record['bbox']}"
