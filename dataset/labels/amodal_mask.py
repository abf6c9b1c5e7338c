"""The mask of a whole vehicle in the image, with the pixels that others hide, as COCO's run lengths."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from msgspec import Struct

from hulldown.annotate.masks import covers, encode, extent
from hulldown.assets.coco_types import Record
from hulldown.dataset.labels.label_type import LabelType, SeenVehicle
from hulldown.dataset.labels.mask import outside


class Fields(Struct):
    """The same form as `segmentation`."""

    segmentation_amodal: dict[str, Any] | None = None


def _of_scene(vehicle: SeenVehicle) -> dict[str, Any]:
    return {"segmentation_amodal": encode(vehicle.whole)}


def _problems(label: Record, image: Record, category: Record) -> Iterator[str]:
    """Find a damaged amodal mask, one outside of the box, and one that lacks visible pixels."""
    if (whole := label.get("segmentation_amodal")) is None:
        return
    size = image["width"], image["height"]
    try:
        _, box = extent(whole, *size)
    except ValueError as error:
        yield f"segmentation_amodal: {error}"
        return
    yield from outside(label, box, "its amodal mask")
    try:
        if (visible := label.get("segmentation")) and not covers(whole, visible, *size):
            yield "its amodal mask lacks pixels of its mask"
    except ValueError:
        return  # the visible mask is damaged, which is found there


AMODAL_MASK = LabelType(Fields, _problems, of_scene=_of_scene)
