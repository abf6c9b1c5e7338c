"""The box of a vehicle's surface in the image, and in front of the camera; `annotate.boxes` computes both for plans."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from msgspec import Meta

from hulldown.annotate.label_type import LabelType
from hulldown.annotate.record_fields import MAX_BOX_OVERHANG_PX, PICTURE_HASH_KEY, TEXT_ROUNDING_PX, Box
from hulldown.annotate.records import Category, Image, Label, box_overhang_px


class SurfaceBox(LabelType):
    """The box of the whole surface in front of the camera; `bbox`, which all labels have, is inside the image."""

    bbox_amodal: Annotated[Box | None, Meta(description="[box](boxes.md) of the whole vehicle, cut off or not")] = None

    def problems(self, label: Label, image: Image, category: Category | None) -> Iterator[str]:
        """Find a box outside of its image, or of its amodal box."""
        x, y, w, h = label.bbox.tolist()
        limit = TEXT_ROUNDING_PX if PICTURE_HASH_KEY in image.record else MAX_BOX_OVERHANG_PX
        if box_overhang_px(label.bbox, *image.size) > limit:
            yield f"bbox {label.record['bbox']} leaves its image of {image.width} x {image.height}"
        if self.bbox_amodal is not None:
            a, b, c, d = self.bbox_amodal
            slack = TEXT_ROUNDING_PX * max(1.0, c, d)
            if x < a - slack or y < b - slack or x + w > a + c + slack or y + h > b + d + slack:
                yield f"bbox {label.record['bbox']} is not inside bbox_amodal {list(self.bbox_amodal)}"
