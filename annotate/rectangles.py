"""Oriented boxes: smallest rectangles around masks, as center, width, height, and angle from the image's x to y."""

from __future__ import annotations

import numpy as np
import shapely
from jaxtyping import Float
from numpy.typing import ArrayLike

from hulldown.annotate.masks import run_starts_and_ends
from hulldown.base.arrays import checked_array

RECTANGLE_ROUNDING_PX = 1e-5  # more than sides and angles are rounded by
_UNIT_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def smallest_mask_rectangle(segmentation: object, width: int, height: int) -> Float[np.ndarray, "5"] | None:
    """Return center, width, height, and angle of the smallest rectangle around a mask; None for an empty mask."""
    corners = _mask_corners(segmentation, width, height)
    if not len(corners):
        return None
    around = shapely.get_coordinates(shapely.oriented_envelope(shapely.linestrings(corners)))[:4]
    first, second = around[1] - around[0], around[2] - around[1]
    sides = np.hypot(*first), np.hypot(*second)
    along = first if sides[0] >= sides[1] else second
    angle = (np.arctan2(along[1], along[0]) + np.pi / 2) % np.pi - np.pi / 2
    return np.array([*around.mean(axis=0), max(sides), min(sides), angle])


def is_smallest_rectangle(rectangle: ArrayLike, segmentation: object, width: int, height: int) -> bool:
    """Return whether a rectangle is a smallest one around a mask, up to rounding; a triangle has three."""
    given = checked_array(rectangle, "rectangle", (5,))
    smallest = smallest_mask_rectangle(segmentation, width, height)
    if smallest is None or abs(given[2] * given[3] - smallest[2] * smallest[3]) > RECTANGLE_ROUNDING_PX * (
        1.0 + smallest[2:4].sum()
    ):
        return False
    along = np.array([np.cos(given[4]), np.sin(given[4])])
    off = _mask_corners(segmentation, width, height) - given[:2]
    reach = [np.abs(off @ axis).max() for axis in (along, np.array([-along[1], along[0]]))]
    return bool((reach <= given[2:4] / 2 + RECTANGLE_ROUNDING_PX).all())


def _mask_corners(segmentation: object, width: int, height: int) -> Float[np.ndarray, "n 2"]:
    first, end = run_starts_and_ends(segmentation, width, height)
    left, top, right, bottom = first // height, first % height, (end - 1) // height, (end - 1) % height + 1
    # A run that goes through several columns is a bar in the first, one in the last, and a block between them.
    one_column, full = left == right, np.full(len(first), height)
    bars = [(left, left + 1, top, np.where(one_column, bottom, full)), (right, right + 1, np.where(one_column, top, 0), bottom)]
    bars.append((np.minimum(left + 1, right), right, np.where(one_column, top, 0), np.where(one_column, bottom, full)))
    corners = [np.stack([bar[i], bar[j]], axis=1) for bar in bars for i in (0, 1) for j in (2, 3)]
    return np.concatenate(corners).astype(np.float64)


def rectangle_corners(rectangles: ArrayLike) -> Float[np.ndarray, "... 4 2"]:
    """Return corners of rectangles (..., 5), in order around each; the first two are where its height begins."""
    given = checked_array(rectangles, "rectangles", ("...", 5))
    angle = given[..., 4, None]
    x, y = np.moveaxis(_UNIT_CORNERS * given[..., None, 2:4], -1, 0)
    turned = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=-1)
    return given[..., None, :2] + turned
