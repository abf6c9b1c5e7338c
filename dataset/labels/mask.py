"""The mask of what is visible of a vehicle, as COCO's run lengths or polygons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from msgspec import Struct

from hulldown.annotate.masks import encode, extent
from hulldown.assets.coco_types import Record
from hulldown.dataset.labels.label_type import LabelType, SeenVehicle
from hulldown.dataset.store.declared import Side

OUTSIDE = 1.0  # pixels that a mask may reach beyond its box


class Fields(Struct):
    """Pixels of the mask; `annotate.masks.decode` checks `segmentation`, which comes in several forms."""

    area: Side | None = None


def _of_scene(vehicle: SeenVehicle) -> dict[str, Any]:
    return {"segmentation": encode(vehicle.visible), "area": int(np.count_nonzero(vehicle.visible))}


def _problems(label: Record, image: Record, category: Record) -> Iterator[str]:
    """Find a damaged mask, one outside of its box, and another number of pixels."""
    if not (mask := label.get("segmentation")):
        return
    try:
        pixels, box = extent(mask, image["width"], image["height"])
    except ValueError as error:
        yield str(error)
        return
    yield from outside(label, box, "its mask")
    if isinstance(mask, Mapping) and label.get("area") is not None and label["area"] != pixels:
        yield f"area is {label['area']}, its mask has {pixels} pixels"


def outside(label: Record, extent: Float[np.ndarray, "4"] | None, what: str) -> Iterator[str]:
    """Find a mask, by its extent as of `annotate.masks.extent`, that reaches out of the label's box."""
    if extent is None:
        return
    x, y, w, h = label["bbox"]
    low, high = extent[:2] - (x, y), extent[:2] + extent[2:] - (x + w, y + h)
    if low.min() < -OUTSIDE or high.max() > OUTSIDE:
        yield f"{what} covers {extent.tolist()}, beyond its bbox {label['bbox']}"


MASK = LabelType(Fields, _problems, of_scene=_of_scene)
