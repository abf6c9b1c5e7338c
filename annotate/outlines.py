"""Masks as polygons, for tools without run lengths, with simplification."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import contourpy
import numpy as np
from jaxtyping import Bool, Float

from hulldown.annotate.masks import decode_mask

Ring = Float[np.ndarray, "_ 2"]


def mask_polygons(segmentation: object, width: int, height: int, *, within: float = 0.0) -> list[list[float]]:
    """Return a segmentation's pieces as polygons, with holes bridged, simplified by at most `within` pixels."""
    if not within >= 0.0:
        raise ValueError(f"within: expected pixels, at least 0, got {within!r}")
    corners = []
    for rings in _piece_outlines(decode_mask(segmentation, width, height)):
        outer, *holes = (simplify_ring(ring, within) for ring in rings)
        if len(outer) >= 3:
            whole = bridge_rings([outer, *(hole for hole in holes if len(hole) >= 3)])
            corners.append([float(number) for number in np.round(whole, 3).ravel()])
    return corners


def bridge_rings(rings: Sequence[Ring]) -> Ring:
    """Join open rings, in pixels, into one: bridges without width are where they come nearest to the first."""
    whole = np.asarray(rings[0], dtype=np.float64)
    for ring in rings[1:]:
        apart = ((whole[:, None] - ring[None]) ** 2).sum(axis=2)
        here, there = np.unravel_index(np.argmin(apart), apart.shape)
        round_trip = np.roll(ring, -int(there), axis=0)
        whole = np.concatenate([whole[: here + 1], round_trip, round_trip[:1], whole[here:]])
    return whole


def simplify_ring(ring: Ring, within: float) -> Ring:
    """Drop corners of a ring that are `within` pixels of the line between kept ones (Douglas and Peucker, 1973)."""
    first = int(np.argmax(((ring - ring.mean(axis=0)) ** 2).sum(axis=1)))
    ring = np.roll(ring, -first, axis=0)
    closed = np.concatenate([ring, ring[:1]])
    far = int(np.argmax(((ring - ring[0]) ** 2).sum(axis=1)))
    keep = np.zeros(len(closed), dtype=bool)
    keep[[0, far]] = True
    spans = [(0, far), (far, len(ring))]
    while spans:
        start, end = spans.pop()
        if end - start < 2:
            continue
        away = _line_distances(closed[start + 1 : end], closed[start], closed[end])
        worst = int(np.argmax(away))
        if away[worst] > within:
            middle = start + 1 + worst
            keep[middle] = True
            spans += [(start, middle), (middle, end)]
    return ring[keep[:-1]]


def _line_distances(points: Ring, start: Float[np.ndarray, "2"], end: Float[np.ndarray, "2"]) -> Float[np.ndarray, " _"]:
    along = end - start
    length = float(along @ along)
    share = np.clip((points - start) @ along / length, 0.0, 1.0) if length else np.zeros(len(points))
    return np.sqrt(((points - start - share[:, None] * along) ** 2).sum(axis=1))


def _piece_outlines(mask: Bool[np.ndarray, "h w"]) -> list[list[Ring]]:
    """Return the outline of each piece of a mask, then those of its holes, in pixels."""
    if not mask.any():
        return []
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, left = rows[0], columns[0]
    framed = np.pad(mask[top : rows[-1] + 1, left : columns[-1] + 1].astype(np.float64), 1)
    generator = contourpy.contour_generator(z=framed, fill_type=contourpy.FillType.OuterOffset)
    found = []
    for points, offsets in zip(*generator.filled(0.5, np.inf), strict=True):
        # Each ring ends with its first corner; the frame moved all by one, and centers are at one half.
        rings = [points[start : end - 1] + np.array([left - 0.5, top - 0.5]) for start, end in pairwise(offsets)]
        found.append(rings)
    return found
