"""The part of a vehicle's underside that stands on the ground."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from geometry.arrays import checked


def contact_footprint(vertices: ArrayLike, *, band: float = 0.05, least: float = 0.2) -> Float[np.ndarray, "2 2"]:
    """Lowest and highest (x, y) of what touches the ground: the lowest part of a mesh, seen from above.

    A long barrel, a dozer blade held high or an antenna widen the bounding box and touch no ground; wheels, tracks and
    skids are low. The band begins at the lowest vertex and is doubled until what it holds is wide enough to stand on.

    Parameters
    ----------
    vertices
        (v, 3) of the parts that stand on the ground, vehicle frame, z up.
    band
        Height of the part that counts as touching, as a share of the height of all vertices.
    least
        Least length and width of the footprint, as shares of those of all vertices.

    Returns
    -------
    numpy.ndarray
        (2, 2) corners for the `footprint` of `placement.settle.settle`.
    """
    points = checked(vertices, "vertices", ("v", 3))
    if not len(points):
        raise ValueError("vertices: expected at least one vertex, got none")
    if not (0 < band <= 1 and 0 <= least <= 1):
        raise ValueError(f"band, least: expected shares in (0, 1] and [0, 1], got {band} and {least}")
    low, high = points.min(axis=0), points.max(axis=0)
    while True:
        touching = points[points[:, 2] <= low[2] + band * (high[2] - low[2]), :2]
        box = np.stack([touching.min(axis=0), touching.max(axis=0)])
        if band >= 1 or (box[1] - box[0] >= least * (high - low)[:2]).all():
            return box
        band = min(2 * band, 1.0)
