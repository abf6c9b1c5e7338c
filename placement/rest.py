"""Two rules that fit the resting plane to a footprint's samples of the ground.

Both work in the footprint's own frame, turned by the heading but level, where the samples' positions are the same
for every candidate. docs/settling.md compares them with a reference rest pose. Sums are explicit, since the rounding of
a matrix product may depend on the number of rows, and a candidate's pose must not depend on the others. (The product
in `placement.simplex` is of whole numbers, and exact.)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from hulldown.placement.footprint import Samples
from hulldown.placement.support import Rest, support_plane


def averaged(
    samples: Float[np.ndarray, "m 2"],
    heights: Float[np.ndarray, "k m"],
    normals: Float[np.ndarray, "k m 3"],
    valid: Bool[np.ndarray, "k m"],
) -> Rest:
    """Return the plane through the mean of the hits, normal to the mean of their normals.

    `normals`: unit normals in the turned frames.

    References
    ----------
    Paper, section 2.1.5.
    """
    count = np.maximum(valid.sum(axis=1), 1)
    height = np.where(valid, heights, 0.0).sum(axis=1) / count
    mean = np.where(valid[..., None], normals, 0.0).sum(axis=1)
    has_plane = mean[:, 2] > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        gradient = -mean[:, :2] / mean[:, 2:]
    # The mean height belongs to the mean position of the valid samples, which need not be the origin.
    center_x = (valid * samples[:, 0]).sum(axis=1) / count
    center_y = (valid * samples[:, 1]).sum(axis=1) / count
    at_origin = height - gradient[:, 0] * center_x - gradient[:, 1] * center_y
    return Rest(at_origin, gradient, has_plane, np.full(len(has_plane), np.nan))


def support(samples: Samples, heights: Float[np.ndarray, "k m"], valid: Bool[np.ndarray, "k m"]) -> Rest:
    """Return the lowest plane above all hits at the footprint's center, where the center of gravity is taken to be.

    Where the underside is higher than the plane, a hit may be as much higher too. That height is taken straight up from
    the plane: docs/settling.md bounds what this leaves out.
    """
    solid = np.isfinite(samples.height)  # others support nothing
    clear = np.compress(solid, heights, axis=1) - samples.height[solid]
    plane = support_plane(samples.xy[solid] - samples.center, clear, np.compress(solid, valid, axis=1))
    height = plane.height - plane.gradient[:, 0] * samples.center[0] - plane.gradient[:, 1] * samples.center[1]
    return replace(plane, height=height)
