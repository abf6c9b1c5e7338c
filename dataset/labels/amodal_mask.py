"""The mask of a whole vehicle in the image, with the pixels that others hide, as COCO's run lengths."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from hulldown.annotate.masks import covers, encode, extent
from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.labels.label_type import LabelType, SeenVehicle
from hulldown.dataset.labels.mask import MASK, outside


class Fields(Struct):
    """The same form as `segmentation`."""

    segmentation_amodal: dict[str, object] | None = None


def _of_scene(vehicle: SeenVehicle) -> Fields:
    return Fields(encode(vehicle.whole))


def _problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find a damaged amodal mask, one outside of the box, and one that lacks visible pixels."""
    if (whole := AMODAL_MASK.read(label).segmentation_amodal) is None:
        return
    try:
        _, box = extent(whole, *image.size)
    except ValueError as error:
        yield f"segmentation_amodal: {error}"
        return
    yield from outside(label, box, "its amodal mask")
    try:
        if (visible := MASK.read(label).segmentation) and not covers(whole, visible, *image.size):
            yield "its amodal mask lacks pixels of its mask"
    except ValueError:
        return  # the visible mask is damaged, which is found there


AMODAL_MASK = LabelType(Fields, _problems, of_scene=_of_scene)
