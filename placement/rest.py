"""Two rules that fit the resting plane to a footprint's samples of the ground.

Both work in the footprint's own frame, turned by the heading but level, where the samples' positions are the same for
every candidate. docs/settling.md compares them with a reference rest pose. Sums are explicit, since the rounding of a
matrix product may depend on the number of rows and on the processor.

The support plane is that of a rigid footprint at rest. Set down on rough ground, it touches it in (at least) three
points whose triangle surrounds the center of gravity. Of all triangles of samples around the center, that is the one
that carries it highest: no sample is above its plane, which is the lowest under the center of all planes that no sample
is above. A grid of 5 x 5 samples has 626 such triangles, so all of them are compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.base.indices import index_batches
from hulldown.base.portable import hypot
from hulldown.placement.footprint import Samples

# A center exactly on a line through two samples (always so on a regular grid) leaves the triangle to chance. Moved by
# these shares of the footprint, no line through two samples meets it.
PLANE_NUDGE = np.array([1.0e-6, 1.0e-6 * (math.sqrt(5.0) - 1) / 2])
OTHER_WAYS = np.array([[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
MIN_CONTACT_WEIGHT_SHARE = 1e-4  # of all weight, on a sample; below it the center counts as on an edge
_ROWS_PER_BLOCK = 64  # their triangles stay in cache


@dataclass(frozen=True, eq=False, slots=True)
class Rest:
    """Rest planes z = height + gradient . (x, y) about the vehicle's origin, in frames turned by the headings.

    `margin` is how far the center lies inside the triangle of three contacts; nan for the rule without contacts. Where
    it's 0, the center is right above a contact, or between two, and the plane may tip several ways; it's then the mean
    of those, which touches that contact or those two.
    """

    height: Float[np.ndarray, " n"]
    gradient: Float[np.ndarray, "n 2"]
    found: Bool[np.ndarray, " n"]
    margin: Float[np.ndarray, " n"]


def fit_averaged_planes(
    samples_xy: Float[np.ndarray, "m 2"],
    heights: Float[np.ndarray, "n m"],
    normals: Float[np.ndarray, "n m 3"],
    valid: Bool[np.ndarray, "n m"],
) -> Rest:
    """Return the plane through the mean of the hits, normal to the mean of their normals (paper, section 2.1.5)."""
    count = np.maximum(valid.sum(axis=1), 1)
    height = np.where(valid, heights, 0.0).sum(axis=1) / count
    mean = np.where(valid[..., None], normals, 0.0).sum(axis=1)
    has_plane = mean[:, 2] > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        gradient = -mean[:, :2] / mean[:, 2:]
    # The mean height belongs to the mean position of the valid samples, which need not be the origin.
    center_x = (valid * samples_xy[:, 0]).sum(axis=1) / count
    center_y = (valid * samples_xy[:, 1]).sum(axis=1) / count
    at_origin = height - gradient[:, 0] * center_x - gradient[:, 1] * center_y
    return Rest(at_origin, gradient, has_plane, np.full(len(has_plane), np.nan))


def fit_underside_planes(samples: Samples, heights: Float[np.ndarray, "n m"], valid: Bool[np.ndarray, "n m"]) -> Rest:
    """Return the support plane at the footprint's center, with heights straight up from it; see docs/settling.md."""
    solid = np.isfinite(samples.height)  # others support nothing
    clear = np.compress(solid, heights, axis=1) - samples.height[solid]
    plane = fit_support_planes(samples.xy[solid] - samples.center, clear, np.compress(solid, valid, axis=1))
    height = plane.height - plane.gradient[:, 0] * samples.center[0] - plane.gradient[:, 1] * samples.center[1]
    return Rest(height, plane.gradient, plane.found, plane.margin)


def fit_support_planes(
    samples_xy: Float[np.ndarray, "m 2"], heights: Float[np.ndarray, "n m"], valid: Bool[np.ndarray, "n m"]
) -> Rest:
    """Return the lowest plane above all valid samples, for each row of heights."""
    n = len(heights)
    coefficients, margin = np.full((n, 3), np.nan), np.full(n, np.nan)
    heights = np.where(valid, heights, -np.inf)
    # Relative to the highest sample, so that rounding scales with the relief and not with the altitude.
    top = heights.max(axis=1, initial=-np.inf)
    top[np.isneginf(top)] = 0.0
    heights -= top[:, None]
    nudge = PLANE_NUDGE * np.ptp(samples_xy, axis=0) if len(samples_xy) else PLANE_NUDGE
    contacts = _highest_triangles(samples_xy, heights, nudge)
    found = contacts[:, 0] >= 0
    heights, contacts = heights[found], contacts[found]
    corners = samples_xy[contacts]
    plane = _planes_through_corners(corners, np.take_along_axis(heights, contacts, axis=1))
    weight = np.abs(_opposite_areas(corners, np.zeros(2)))
    side = corners[:, (1, 2, 0)] - corners[:, (2, 0, 1)]
    margin[found] = (weight / hypot(side[..., 0], side[..., 1])).min(axis=1)
    idle = weight < MIN_CONTACT_WEIGHT_SHARE * weight.sum(axis=1, keepdims=True)
    ties = idle.sum(axis=1)
    edge, above_contact = np.flatnonzero(ties == 1), np.flatnonzero(ties == 2)
    plane[edge] = _mean_planes_over_edge(samples_xy, heights[edge], contacts[edge], np.argmax(idle[edge], axis=1), plane[edge])
    plane[above_contact] = _mean_planes_over_contact(samples_xy, heights[above_contact], nudge, plane[above_contact])
    coefficients[found] = plane
    return Rest(coefficients[:, 2] + top, coefficients[:, :2], found, margin)


def _highest_triangles(
    samples_xy: Float[np.ndarray, "m 2"], heights: Float[np.ndarray, "n m"], center: Float[np.ndarray, "2"]
) -> Int[np.ndarray, "n 3"]:
    """Return the triangle of samples around a center that carries it highest; -1 where there is none."""
    triangles, shares = _triangles_and_corner_shares(samples_xy.tobytes(), *center.tolist())
    highest = np.full((len(heights), 3), -1)
    if not triangles.size:
        return highest
    for rows in index_batches(len(heights), _ROWS_PER_BLOCK):
        by_sample = np.ascontiguousarray(heights[rows].T)
        carried = np.zeros((triangles.shape[1], by_sample.shape[1]))
        for corner, share in zip(triangles, shares, strict=True):
            carried += share[:, None] * by_sample.take(corner, axis=0)
        best = carried.argmax(axis=0)
        finite = np.isfinite(carried[best, np.arange(len(best))])
        highest[rows] = np.where(finite[:, None], triangles[:, best].T, -1)
    return highest


@lru_cache(maxsize=256)
def _triangles_and_corner_shares(samples: bytes, x: float, y: float) -> tuple[Int[np.ndarray, "3 t"], Float[np.ndarray, "3 t"]]:
    """Return the triangles of samples around a center, counterclockwise, and their corners' shares of the load."""
    samples_xy, center = np.frombuffer(samples).reshape(-1, 2), np.array([x, y])
    triangles = np.array(list(combinations(range(len(samples_xy)), 3)), dtype=int).reshape(-1, 3)
    area = _opposite_areas(samples_xy[triangles], center).sum(axis=1)
    triangles[area < 0] = triangles[area < 0, ::-1]
    parts = _opposite_areas(samples_xy[triangles], center)
    area = np.abs(area)
    around = (area > 1e-9 * area.max(initial=0.0)) & (parts > 0).all(axis=1)
    return np.ascontiguousarray(triangles[around].T), np.ascontiguousarray((parts[around] / area[around, None]).T)


def _mean_planes_over_edge(
    samples_xy: Float[np.ndarray, "m 2"],
    heights: Float[np.ndarray, "n m"],
    contacts: Int[np.ndarray, "n 3"],
    idle: Int[np.ndarray, " n"],
    plane: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Return the mean of a plane and of it tipped over the two contacts that carry it, to the next sample."""
    a, b = (contacts[np.arange(len(contacts)), (idle + turn) % 3] for turn in (1, 2))
    x, y = np.ascontiguousarray(samples_xy.T)
    along_x, along_y = x[b] - x[a], y[b] - y[a]
    beyond = along_y[:, None] * x
    beyond -= along_x[:, None] * y
    beyond -= (along_y * x[a] - along_x * y[a])[:, None]
    below = plane[:, 2:] - heights + plane[:, :1] * x + plane[:, 1:2] * y
    slope = np.full(below.shape, np.inf)
    # Samples on the edge's own line are beyond it by rounding at most.
    np.divide(below, beyond, out=slope, where=beyond > (1e-9 * (along_x**2 + along_y**2))[:, None])
    third = np.argmin(slope, axis=1)
    some = np.flatnonzero(np.isfinite(slope[np.arange(len(third)), third]))
    other = np.stack([b, a, third], axis=1)[some]
    mean = plane.copy()
    mean[some] += _planes_through_corners(samples_xy[other], np.take_along_axis(heights[some], other, axis=1))
    mean[some] /= 2
    return mean


def _mean_planes_over_contact(
    samples_xy: Float[np.ndarray, "m 2"],
    heights: Float[np.ndarray, "n m"],
    nudge: Float[np.ndarray, "2"],
    plane: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Return the mean of the planes for a center that is nudged to four sides; the plane of the first is given."""
    total, ways = plane.copy(), np.ones((len(plane), 1))
    for way in OTHER_WAYS:
        nudged = _highest_triangles(samples_xy, heights, way * nudge)
        some = np.flatnonzero(nudged[:, 0] >= 0)
        total[some] += _planes_through_corners(
            samples_xy[nudged[some]], np.take_along_axis(heights[some], nudged[some], axis=1)
        )
        ways[some] += 1
    return total / ways


def _planes_through_corners(corners: Float[np.ndarray, "n 3 2"], heights: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    x, y = corners[..., 0], corners[..., 1]
    ax, ay, az = x[:, 1] - x[:, 0], y[:, 1] - y[:, 0], heights[:, 1] - heights[:, 0]
    bx, by, bz = x[:, 2] - x[:, 0], y[:, 2] - y[:, 0], heights[:, 2] - heights[:, 0]
    area = ax * by - ay * bx
    gx, gy = (az * by - bz * ay) / area, (bz * ax - az * bx) / area
    return np.stack([gx, gy, heights[:, 0] - gx * x[:, 0] - gy * y[:, 0]], axis=1)


def _opposite_areas(corners: Float[np.ndarray, "n 3 2"], point: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n 3"]:
    x, y = corners[..., 0] - point[0], corners[..., 1] - point[1]
    return np.stack([x[:, j] * y[:, k] - x[:, k] * y[:, j] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)
