"""The plane a rigid footprint comes to rest on: the lowest plane above all samples, at the centre of gravity.

A vehicle set down on rough ground touches it in (at least) three points whose triangle surrounds the centre of gravity.
Among all planes that lie on or above every sample, the rest plane is the one that is lowest under the centre of
gravity: a linear programme in three unknowns, whose optimum is the facet of the samples' upper convex hull there. The
dual says the same: of all triangles of samples around the centre, the one that carries it highest. The simplex method
below walks from triangle to triangle, for all candidates at once; the samples' positions are the same for all of them,
only the heights differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

# A centre exactly on a line through two samples (always so on a regular grid) leaves the triangle to chance and lets
# the simplex method cycle. Moved by these shares of the footprint, no line through two samples meets it.
NUDGE = np.array([1.0e-6, 1.0e-6 * (5**0.5 - 1) / 2])
TIED = 1e-4  # a sample that carries less than this share of the weight carries nothing: the centre is on an edge
OTHER_WAYS = np.array([[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
MOST_PIVOTS = 500


@dataclass(frozen=True, eq=False, slots=True)
class Support:
    """The rest plane of each candidate: height at the centre, gradient, and three samples around the centre.

    Where the centre is right above a contact, or between two, the plane may tip several ways; it is then the mean of
    those, which touches that contact or those two, and the three samples are those of one way.
    """

    height: Float[np.ndarray, " n"]
    gradient: Float[np.ndarray, "n 2"]
    contacts: Int[np.ndarray, "n 3"]
    found: Bool[np.ndarray, " n"]


def support_plane(
    samples_xy: Float[np.ndarray, "m 2"], heights: Float[np.ndarray, "n m"], valid: Bool[np.ndarray, "n m"]
) -> Support:
    """The lowest plane above all valid samples, for each row of heights.

    Parameters
    ----------
    samples_xy
        (m, 2) positions about the centre of gravity, the same for every row.
    heights
        (n, m) heights of the ground there; anything where not `valid`.
    valid
        (n, m) samples that have ground.

    Returns
    -------
    Support
        `found` is False where the centre lies outside the hull of the valid samples: nothing carries the vehicle there.

    References
    ----------
    Dantzig, Linear Programming and Extensions, 1963, chapter 5 (simplex method, largest-coefficient rule).
    """
    n = len(heights)
    coefficients, contacts = np.full((n, 3), np.nan), np.full((n, 3), -1)
    nudge = NUDGE * np.ptp(samples_xy, axis=0) if len(samples_xy) else NUDGE
    contacts[:] = _triangles(samples_xy, heights, valid, nudge)
    rows = np.flatnonzero(contacts[:, 0] >= 0)
    corners = samples_xy[contacts[rows]]
    coefficients[rows] = _plane(corners, np.take_along_axis(heights[rows], contacts[rows], axis=1))
    # A sample right below the centre (there is one wherever n is odd and the ground is convex) can be tipped about in
    # any direction: one of them, taken at random, would be further from the truth than their mean.
    tied = rows[(np.abs(_weights(corners, np.zeros((1, 2)))) < TIED).any(axis=1)]
    ways = np.ones(len(tied))
    for way in OTHER_WAYS:
        other = _triangles(samples_xy, heights[tied], valid[tied], way * nudge)
        some = np.flatnonzero(other[:, 0] >= 0)
        carrying = np.take_along_axis(heights[tied[some]], other[some], axis=1)
        coefficients[tied[some]] += _plane(samples_xy[other[some]], carrying)
        ways[some] += 1
    coefficients[tied] /= ways[:, None]
    return Support(coefficients[:, 2], coefficients[:, :2], contacts, contacts[:, 0] >= 0)


def _triangles(
    samples_xy: Float[np.ndarray, "m 2"],
    heights: Float[np.ndarray, "n m"],
    valid: Bool[np.ndarray, "n m"],
    nudge: Float[np.ndarray, "2"],
) -> Int[np.ndarray, "n 3"]:
    """The triangle of valid samples around the nudged centre that carries it highest; -1 where there is none."""
    start = _start(samples_xy, nudge)
    if start is None:
        return np.full((len(heights), 3), -1)
    basis = np.tile(start, (len(heights), 1))
    found = np.ones(len(heights), dtype=bool)
    broken = np.flatnonzero(~valid.all(axis=1))
    if len(broken):
        # First a triangle of valid samples only: the same programme with the missing ones one unit below the rest.
        basis[broken] = _climb(samples_xy, -1.0 * ~valid[broken], basis[broken], nudge)
        found[broken] = np.take_along_axis(valid[broken], basis[broken], axis=1).all(axis=1)
        heights = np.where(valid, heights, -np.inf)
    if found.all():
        return _climb(samples_xy, heights, basis, nudge)
    basis[found] = _climb(samples_xy, heights[found], basis[found], nudge)
    basis[~found] = -1
    return basis


def _start(samples_xy: Float[np.ndarray, "m 2"], nudge: Float[np.ndarray, "2"]) -> Int[np.ndarray, "3"] | None:
    """A wide triangle of samples around the nudged centre, or None if there is none."""
    extent = np.ptp(samples_xy, axis=0) if len(samples_xy) else np.zeros(2)
    if (extent <= 0).any():
        return None
    corners = np.array([np.argmax(samples_xy @ d) for d in ((-1, -1.1), (1, -1.1), (1, 1.1), (-1, 1.1))])
    for skipped in range(4):
        triangle = np.delete(corners, skipped)
        if (_weights(samples_xy[triangle][None], nudge[None]) > 0).all():
            return triangle
    return None


def _climb(
    samples_xy: Float[np.ndarray, "m 2"],
    heights: Float[np.ndarray, "n m"],
    basis: Int[np.ndarray, "n 3"],
    centre: Float[np.ndarray, "2"],
) -> Int[np.ndarray, "n 3"]:
    """Pivots each row's triangle until no sample is above its plane; samples at -inf never enter."""
    x, y = np.ascontiguousarray(samples_xy.T)
    finite = np.where(np.isinf(heights), 0.0, heights)
    # Far below any step that matters, far above the rounding of a plane through three samples.
    tolerance = 1e-12 * (1e-3 + np.ptp(finite, axis=1))
    final = basis.copy()
    rows = np.arange(len(basis))
    for _ in range(MOST_PIVOTS):
        corners = samples_xy[basis]
        plane = _plane(corners, np.take_along_axis(heights, basis, axis=1))
        # No matrix product: its rounding may depend on the number of rows, and here it may decide between triangles.
        above = heights - plane[:, 2:]
        above -= plane[:, :1] * x
        above -= plane[:, 1:2] * y
        entering = np.argmax(above, axis=1)
        on = np.flatnonzero(above[np.arange(len(rows)), entering] > tolerance)
        if not len(on):
            break
        rows, basis, corners, entering = rows[on], basis[on], corners[on], entering[on]
        if len(on) < len(heights):
            heights, tolerance = heights[on], tolerance[on]
        step, here = _weights(corners, samples_xy[entering]), _weights(corners, centre[None])
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(step > 0, here / step, np.inf)
        basis[np.arange(len(rows)), np.argmin(ratio, axis=1)] = entering
        final[rows] = basis
    return final


def _plane(corners: Float[np.ndarray, "n 3 2"], heights: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Gradient and height at the origin of the plane through three points each."""
    ax, ay = (corners[:, 1] - corners[:, 0]).T
    bx, by = (corners[:, 2] - corners[:, 0]).T
    az, bz = heights[:, 1] - heights[:, 0], heights[:, 2] - heights[:, 0]
    area = ax * by - ay * bx
    gx, gy = (az * by - bz * ay) / area, (bz * ax - az * bx) / area
    return np.stack([gx, gy, heights[:, 0] - gx * corners[:, 0, 0] - gy * corners[:, 0, 1]], axis=1)


def _weights(corners: Float[np.ndarray, "n 3 2"], points: Float[np.ndarray, "#n 2"]) -> Float[np.ndarray, "n 3"]:
    """Barycentric coordinates of a point each (or one for all) in a triangle each."""
    to_point = corners - points[:, None]
    x, y = to_point[..., 0], to_point[..., 1]
    part = np.stack(
        [
            x[:, 1] * y[:, 2] - x[:, 2] * y[:, 1],
            x[:, 2] * y[:, 0] - x[:, 0] * y[:, 2],
            x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0],
        ],
        axis=1,
    )
    part /= (part[:, 0] + part[:, 1] + part[:, 2])[:, None]
    return part
