"""Vertices of convex hulls, and points that rounding can't tell from them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError


def extreme_points(points: Float[np.ndarray, "n 3"], *, near: float = 0.0) -> Int[np.ndarray, " k"]:
    """Return ascending indices of points that include the maximum of every linear function over all points.

    Parameters
    ----------
    points
        In any frame, at any distance from its origin.
    near
        Points that Qhull's rounding puts on a side of the hull, and that are no farther from one of its vertices than
        this share of the set's size, are taken too: after each point has been moved and rounded by itself, one of
        them may be the greatest in the vertex's place.

    Returns
    -------
    The vertices of the convex hull, up to Qhull's rounding (some 1e-15 of the size), and what is near them; every
    point where all lie in a plane or on a line, or are fewer than four.

    References
    ----------
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


def inner_point(points: Float[np.ndarray, "n 2"], wanted: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
    """The wanted point if it's inside the points' convex hull, else the hull's centroid; `wanted` if there is no hull.

    A point nearer to the hull's edge than a thousandth of the hull's size is not inside.
    """
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
