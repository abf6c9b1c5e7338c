"""Masks of what is visible of a vehicle, as COCO's run lengths or polygons, and of the whole vehicle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from msgspec import Meta

from hulldown.annotate.label_type import LabeledVehicle, LabelType
from hulldown.annotate.masks import covers_mask, decode_mask, encode_mask, mask_area_and_box
from hulldown.annotate.record_fields import Side
from hulldown.annotate.records import Category, Image, Label

MAX_MASK_OVERHANG_PX = 1.0  # a mask may reach this far out of its box


class VisibleMask(LabelType):
    """The mask of a vehicle's visible pixels, and its area."""

    # In one of the forms that `annotate.masks.decode_mask` checks.
    segmentation: Annotated[object, Meta(description="[mask](boxes.md#masks) of what is visible in the image")] = None
    area: Annotated[Side | None, Meta(description="its number of pixels")] = None

    @classmethod
    def compute_fields(cls, vehicle: LabeledVehicle) -> dict[str, object]:
        """Return run lengths of the visible pixels, and their number."""
        if (traced := vehicle.traced) is None:
            return {}
        return {"segmentation": encode_mask(traced.visible), "area": int(np.count_nonzero(traced.visible))}

    def problems(self, label: Label, image: Image, category: Category | None) -> Iterator[str]:
        """Find a damaged mask, one outside of its box, and a wrong number of pixels."""
        if not (mask := self.segmentation):
            return
        try:
            pixels, box = mask_area_and_box(mask, *image.size)
        except ValueError as error:
            yield str(error)
            return
        yield from _find_overhang(label, box, "its mask")
        if isinstance(mask, Mapping) and self.area is not None and self.area != pixels:
            yield f"area is {label.record['area']}, its mask has {pixels} pixels"

    def pixels_to_tint(self, width: int, height: int) -> Bool[np.ndarray, "h w"] | None:
        """Return the mask's pixels."""
        return decode_mask(self.segmentation, width, height) if self.segmentation else None


class AmodalMask(LabelType):
    """The mask of the whole vehicle in the image, hidden or not."""

    segmentation_amodal: Annotated[
        dict[str, object] | None, Meta(description="[mask](boxes.md#masks) of the whole vehicle, hidden or not")
    ] = None

    @classmethod
    def compute_fields(cls, vehicle: LabeledVehicle) -> dict[str, object]:
        """Return run lengths of the vehicle's pixels."""
        return {} if vehicle.traced is None else {"segmentation_amodal": encode_mask(vehicle.traced.whole)}

    def problems(self, label: Label, image: Image, category: Category | None) -> Iterator[str]:
        """Find a damaged amodal mask, one outside of the box, and one that lacks visible pixels."""
        if (whole := self.segmentation_amodal) is None:
            return
        try:
            _, box = mask_area_and_box(whole, *image.size)
        except ValueError as error:
            yield f"segmentation_amodal: {error}"
            return
        yield from _find_overhang(label, box, "its amodal mask")
        try:
            if (visible := label.read(VisibleMask).segmentation) and not covers_mask(whole, visible, *image.size):
                yield "its amodal mask lacks pixels of its mask"
        except ValueError:
            return  # the visible mask is damaged, which is found there


def label_area(label: Label) -> float:
    """Return a label's area in pixels: its record's, or without one its box's."""
    area = label.read(VisibleMask).area
    return float(label.bbox[2] * label.bbox[3]) if area is None else area


def _find_overhang(label: Label, extent: Float[np.ndarray, "4"] | None, what: str) -> Iterator[str]:
    """Find a mask that reaches out of the label's box; `extent` is from `annotate.masks.mask_area_and_box`."""
    if extent is None:
        return
    x, y, w, h = label.bbox
    low, high = extent[:2] - (x, y), extent[:2] + extent[2:] - (x + w, y + h)
    if low.min() < -MAX_MASK_OVERHANG_PX or high.max() > MAX_MASK_OVERHANG_PX:
        yield f"{what} covers {extent.tolist()}, beyond its bbox {label.record['bbox']}"
