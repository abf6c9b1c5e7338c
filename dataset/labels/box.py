"""The box of a vehicle's surface in the image, and in front of the camera; `annotate.boxes` computes both for plans."""

from __future__ import annotations

from collections.abc import Iterator

from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.store.declared import PICTURE_KEY
from hulldown.dataset.usable_labels import MAX_OVERHANG_PX, ROUNDING_PX, beyond


def box_problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find a box outside of its image, or of its amodal box."""
    x, y, w, h = label.bbox.tolist()
    limit = ROUNDING_PX if PICTURE_KEY in image.record else MAX_OVERHANG_PX
    if beyond(label.bbox, *image.size) > limit:
        yield f"bbox {label.record['bbox']} leaves its image of {image.width} x {image.height}"
    if (amodal := label.fields.bbox_amodal) is not None:
        a, b, c, d = amodal
        slack = ROUNDING_PX * max(1.0, c, d)
        if x < a - slack or y < b - slack or x + w > a + c + slack or y + h > b + d + slack:
            yield f"bbox {label.record['bbox']} is not inside bbox_amodal {list(amodal)}"
