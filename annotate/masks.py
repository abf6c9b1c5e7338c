"""COCO's masks: run lengths, polygons read, area, box, and IoU."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from pycocotools import mask as rle_codec

from hulldown.base.arrays import checked_array

MAX_RUN_CHARACTERS = 7  # 35 bits
MAX_POLYGON_IMAGE_PIXELS = 2**32 - 1  # pycocotools counts in 32 bits
MAX_POLYGON_CORNER_PX = 1e6  # pycocotools counts in 32 bits


def encode_mask(mask: ArrayLike) -> dict[str, object]:
    """Return a mask (h, w) as COCO's compressed run lengths, ready for JSON."""
    pixels = checked_array(mask, "mask", ("h", "w"), dtype=np.bool_)
    record = rle_codec.encode(np.asfortranarray(pixels, dtype=np.uint8))
    return {"size": [int(n) for n in record["size"]], "counts": record["counts"].decode("ascii")}


def decode_mask(segmentation: object, width: int, height: int) -> Bool[np.ndarray, "h w"]:
    """Return a COCO segmentation as a mask: run lengths, compressed or not, or a list of polygons."""
    counts = run_lengths(segmentation, width, height)
    return np.repeat(np.arange(len(counts)) % 2 == 1, counts).reshape(width, height).T


def run_lengths(segmentation: object, width: int, height: int) -> Int[np.ndarray, " n"]:
    """Return a COCO segmentation as run lengths by columns, background first, without decoding large images."""
    if isinstance(segmentation, Mapping):
        size, given = segmentation.get("size"), segmentation.get("counts")
        if size != [height, width]:
            raise ValueError(f"segmentation: expected size [{height}, {width}], got {size!r:.60}")
        if isinstance(given, list) and all(isinstance(n, int) and 0 <= n <= width * height for n in given):
            counts = np.array(given, dtype=np.int64)
        elif isinstance(given, str):
            counts = _parse_counts(given)
        else:
            raise ValueError(f"segmentation: expected run lengths under 'counts', got {given!r:.60}")
        if (counts < 0).any() or counts.sum() != width * height:
            raise ValueError(f"segmentation: expected run lengths of {width * height} pixels, got {counts.sum()}")
        return counts
    if not isinstance(segmentation, list) or not segmentation or not all(map(_is_ring, segmentation)):
        raise ValueError("segmentation: expected polygons of at least three points (x1, y1, x2, y2, ...)")
    if width * height > MAX_POLYGON_IMAGE_PIXELS:
        raise ValueError(f"segmentation: expected polygons in an image of {MAX_POLYGON_IMAGE_PIXELS} pixels at most")
    return _parse_counts(rle_codec.merge(rle_codec.frPyObjects(segmentation, height, width))["counts"].decode("ascii"))


def run_starts_and_ends(segmentation: object, width: int, height: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return where each run of a segmentation's pixels begins and ends, by columns; raises as `decode_mask` does."""
    ends = np.cumsum(run_lengths(segmentation, width, height))
    first, end = ends[:-1:2], ends[1::2]
    first, end = first[end > first], end[end > first]
    return first, end


def covers_mask(outer: object, inner: object, width: int, height: int) -> bool:
    """Return whether a segmentation has all pixels of another, without decoding; raises as `decode_mask` does."""
    (first, end), (start, stop) = run_starts_and_ends(outer, width, height), run_starts_and_ends(inner, width, height)
    ends, pixels = np.stack([first, end], axis=1).ravel(), np.cumsum(end - first)
    counted = np.stack([pixels - (end - first), pixels], axis=1).ravel()  # pixels of `outer` before each end
    if not len(ends):
        return not len(start)
    return bool((np.interp(stop, ends, counted) - np.interp(start, ends, counted) == stop - start).all())


def mask_area_and_box(segmentation: object, width: int, height: int) -> tuple[int, Float[np.ndarray, "4"] | None]:
    """Return area and `mask_box` of a segmentation, without decoding it; raises as `decode_mask` does."""
    first, end = run_starts_and_ends(segmentation, width, height)
    if not len(first):
        return 0, None
    left, right = first // height, (end - 1) // height
    several = left < right  # columns: such a run goes through the last row of one and the first of the next
    top = 0 if several.any() else (first % height).min()
    bottom = height if several.any() else ((end - 1) % height).max() + 1
    box = np.array([left.min(), top, right.max() + 1 - left.min(), bottom - top], dtype=np.float64)
    return int((end - first).sum()), box


def _parse_counts(text: str) -> Int[np.ndarray, " n"]:
    """Read and check COCO's compressed run lengths: 5 bits a character, lowest first, differences from the 4th on."""
    codes = np.frombuffer(text.encode("ascii", "replace"), dtype=np.uint8).astype(np.int64) - 48
    last = np.flatnonzero(codes & 32 == 0)
    first = np.append(0, last[:-1] + 1)
    whole = text.isascii() and len(last) > 0 and last[-1] == len(codes) - 1
    length = last - first + 1 if whole else np.array([0])
    if not whole or codes.min() < 0 or codes.max() > 63 or length.max() > MAX_RUN_CHARACTERS:
        raise ValueError("segmentation: expected compressed run lengths under 'counts', got damaged ones")
    place = np.arange(len(codes)) - np.repeat(first, length)
    numbers = np.add.reduceat((codes & 31) << (5 * place), first)
    numbers -= (codes[last] >> 4 & 1) << (5 * length)  # the highest bit is the sign
    numbers[1::2], numbers[2::2] = np.cumsum(numbers[1::2]), np.cumsum(numbers[2::2])
    return numbers


def _is_ring(value: object) -> bool:
    return (
        isinstance(value, list)
        and len(value) >= 6
        and len(value) % 2 == 0
        and all(isinstance(n, int | float) and abs(n) <= MAX_POLYGON_CORNER_PX for n in value)
    )


def mask_box(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "4"] | None:
    """Return the xywh of a mask's pixels, from outer edge to outer edge; None if it has none."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not len(columns):
        return None
    x, y = float(columns[0]), float(rows[0])
    return np.array([x, y, columns[-1] + 1.0 - x, rows[-1] + 1.0 - y])


def mask_iou(a: Bool[np.ndarray, "h w"], b: Bool[np.ndarray, "h w"]) -> float:
    """Return the share of two masks' pixels that both have; 1 for two empty masks."""
    either = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / either) if either else 1.0
