"""Exact clipping of triangles by planes, and boxes of points."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, UInt8

EMPTY_EXTREMES = np.array([np.inf, np.inf, -np.inf, -np.inf])


def extremes_of_points(pixels: Float[np.ndarray, "2 *n"]) -> Float[np.ndarray, "4"]:
    """Return lowest u, lowest v, highest u, highest v; an empty box (inf, inf, -inf, -inf) of no points."""
    u, v = pixels
    if not u.size:
        return EMPTY_EXTREMES
    return np.array([u.min(), v.min(), u.max(), v.max()])


def clip_triangles_to_polygons(
    triangles: Float[np.ndarray, "3 f 3"], planes: Float[np.ndarray, "k 4"]
) -> tuple[Float[np.ndarray, "3 n"], Int[np.ndarray, " n"], UInt8[np.ndarray, " n"]]:
    """Clip triangles (Sutherland, Hodgman): corners, each one's polygon, and as bits the planes that cut it."""
    count = triangles.shape[1]
    points = triangles.reshape(3, -1)
    polygon = np.repeat(np.arange(count), 3)
    on = np.zeros(len(polygon), dtype=np.uint8)
    for i, plane in enumerate(planes):
        if not len(polygon):
            break
        distance = signed_plane_distances(plane, points)
        inside = distance >= 0.0
        if inside.all():
            continue
        following = next_corner_indices(polygon)
        crossing = inside != inside[following]
        share = distance[crossing] / (distance[crossing] - distance[following[crossing]])
        start, end = points[:, crossing], points[:, following[crossing]]
        # Each corner may be kept, and be followed by the point where its edge crosses the plane.
        kept = np.zeros((len(polygon), 2), dtype=bool)
        kept[:, 0], kept[:, 1] = inside, crossing
        kept_points = np.empty((3, len(polygon), 2))
        kept_points[:, :, 0] = points
        kept_points[:, crossing, 1] = start + share * (end - start)
        flags = np.empty((len(polygon), 2), dtype=np.uint8)
        flags[:, 0] = on
        flags[:, 1] = (on & on[following]) | np.uint8(1 << i)
        points, on = kept_points[:, kept], flags[kept]
        polygon = np.repeat(polygon, kept.sum(axis=1))
    return points, polygon, on


def union_extremes(a: Float[np.ndarray, "4"], b: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
    """Return the smallest box around two; either may be empty."""
    return np.concatenate([np.minimum(a[:2], b[:2]), np.maximum(a[2:], b[2:])])


def next_corner_indices(polygon: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return the index of the next corner of the same polygon, for each corner in a flat list of polygons."""
    following = np.arange(1, len(polygon) + 1)
    last = np.flatnonzero(np.diff(polygon, append=-1))
    following[last] = np.searchsorted(polygon, polygon[last])
    return following


def signed_plane_distances(plane: Float[np.ndarray, "4"], points: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "*n"]:
    """Return the signed, scaled distance of points from a plane; it isn't negative inside."""
    terms = [factor * x for factor, x in zip(plane.tolist(), (*points, 1.0), strict=True) if factor]
    return sum(terms[1:], start=terms[0])
