"""Vertices of convex hulls, and points that rounding can't tell from them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

COLLINEAR_TOLERANCE = 1e-12  # for points whose coordinates are about 1


def extreme_point_indices(points: Float[np.ndarray, "n 3"], *, near: float = 0.0) -> Int[np.ndarray, " k"]:
    """Return ascending indices of points that include the maximum of every linear function over all points.

    `points`: in any frame, at any distance from its origin.
    `near`: points that Qhull's rounding puts on a side of the hull, and that are no farther from one of its vertices
    than this share of the set's size, are taken too: after each point has been moved and rounded by itself, one of
    them may be the greatest in the vertex's place.

    Barber, Dobkin, Huhdanpaa, The Quickhull algorithm for convex hulls, ACM TOMS 22(4), 1996.
    """
    if len(points) < 4:
        return np.arange(len(points))
    about_middle = points - points.mean(axis=0)
    try:
        hull = ConvexHull(about_middle, qhull_options="Qt Qc" if near > 0.0 else "Qt")
    except QhullError:
        return np.arange(len(points))
    if near <= 0.0:
        return np.sort(hull.vertices)  # not their twins
    point, _, vertex = hull.coplanar.reshape(-1, 3).T
    reach = near * np.ptp(about_middle, axis=0).max()
    close = np.abs(about_middle[point] - about_middle[vertex]).max(axis=1, initial=0.0) <= reach
    return np.union1d(hull.vertices, point[close])


def wanted_point_or_centroid(points: Float[np.ndarray, "n 2"], wanted: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
    """Return `wanted` if it's inside the hull by a thousandth of its size, or there is no hull; else the centroid."""
    if len(points) < 3:
        return wanted
    about = points - wanted
    try:
        hull = ConvexHull(about)
    except QhullError:
        return wanted
    if hull.equations[:, 2].max() < -1e-3 * np.ptp(about, axis=0).max():
        return wanted
    ring = about[hull.vertices]
    following = np.roll(ring, -1, axis=0)
    area = ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0]
    return wanted + ((ring + following) * area[:, None]).sum(axis=0) / (3.0 * area.sum())


def hull_corners_and_groups(
    points: Float[np.ndarray, "n 2"], group: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "k 2"], Int[np.ndarray, " k"]]:
    """Return the corners of each group's convex hull, counterclockwise, and their groups, ascending.

    Groups without an area have none. Corners within `COLLINEAR_TOLERANCE` of a straight line are left out.

    Andrew, Another efficient algorithm for convex hulls in two dimensions, Information Processing Letters, 1979.
    """
    order = np.lexsort((points[:, 1], points[:, 0], group))
    points, group = points[order], group[order]
    column = np.append(True, (np.diff(points[:, 0]) != 0.0) | (np.diff(group) != 0))[: len(points)]
    below = _hull_side_indices(points, group, np.flatnonzero(column), 1.0)
    above = _hull_side_indices(points, group, np.flatnonzero(np.append(column[1:], True)[: len(points)]), -1.0)[::-1]
    ring = np.concatenate([below, above])
    ring = ring[np.argsort(group[ring], kind="stable")]
    # The chains share their ends, unless the leftmost or rightmost side is upright.
    apart = (points[ring] != points[np.roll(ring, 1)]).any(axis=1) | (group[ring] != group[np.roll(ring, 1)])
    ring = ring[apart]
    first = np.flatnonzero(np.append(True, np.diff(group[ring]) != 0)[: len(ring)])
    size = np.diff(first, append=len(ring))
    closes = (points[ring[first]] == points[ring[first + size - 1]]).all(axis=1) & (size > 1)
    kept = np.ones(len(ring), dtype=bool)
    kept[(first + size - 1)[closes]] = False
    kept &= np.repeat(size - closes > 2, size)
    return points[ring[kept]], group[ring[kept]]


def _hull_side_indices(
    points: Float[np.ndarray, "n 2"], group: Int[np.ndarray, " n"], chain: Int[np.ndarray, " c"], side: float
) -> Int[np.ndarray, " k"]:
    """Return which points of each group, by ascending x, are corners of its hull's lower (1.0) or upper (-1.0) side."""
    while len(chain) > 2:
        before, here, after = chain[:-2], chain[1:-1], chain[2:]
        one, other = points[here] - points[before], points[after] - points[here]
        turn = side * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
        straight = turn <= COLLINEAR_TOLERANCE * np.linalg.norm(points[after] - points[before], axis=1)
        removed = straight & (group[before] == group[here]) & (group[after] == group[here])
        if not removed.any():
            break
        chain = np.delete(chain, 1 + np.flatnonzero(removed))
    return chain
