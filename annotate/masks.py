"""Masks as COCO stores them, and what they say: run lengths, area, box, overlap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from pycocotools import mask as rle_codec

from geometry.arrays import checked


def encode(mask: ArrayLike) -> dict[str, Any]:
    """A mask (h, w) as COCO's compressed run lengths, ready for JSON."""
    pixels = checked(mask, "mask", ("h", "w"), dtype=np.bool_)
    record = rle_codec.encode(np.asfortranarray(pixels, dtype=np.uint8))
    return {"size": [int(n) for n in record["size"]], "counts": record["counts"].decode("ascii")}


def decode(
    segmentation: Mapping[str, Any] | Sequence[Sequence[float]], width: int, height: int
) -> Bool[np.ndarray, "h w"]:
    """A COCO segmentation as a mask: run lengths, compressed or not, or a list of polygons.

    Raises
    ------
    ValueError
        If it is neither, or its size is not that of the image.
    """
    if isinstance(segmentation, Mapping):
        size = segmentation.get("size")
        if list(size or ()) != [height, width]:
            raise ValueError(f"segmentation: expected size [{height}, {width}], got {size!r}")
        record: Any = dict(segmentation)
        if isinstance(record["counts"], list):
            record = rle_codec.frPyObjects(record, height, width)
    else:
        rings = [list(ring) for ring in segmentation]
        if not rings or any(len(ring) < 6 or len(ring) % 2 for ring in rings):
            raise ValueError("segmentation: expected polygons of at least three points (x1, y1, x2, y2, ...)")
        record = rle_codec.merge(rle_codec.frPyObjects(rings, height, width))
    return rle_codec.decode(record).astype(bool)


def area(mask: Bool[np.ndarray, "h w"]) -> int:
    """Pixels of a mask, COCO's ``area``."""
    return int(np.count_nonzero(mask))


def mask_box(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "4"] | None:
    """Xywh of the pixels of a mask, outer edge to outer edge; None if it has none."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not len(columns):
        return None
    x, y = float(columns[0]), float(rows[0])
    return np.array([x, y, columns[-1] + 1.0 - x, rows[-1] + 1.0 - y])


def iou(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    """Shared pixels over all pixels of two masks; 1 for two empty ones."""
    either = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / either) if either else 1.0
