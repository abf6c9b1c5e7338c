"""The plane a rigid footprint comes to rest on: the lowest plane above all samples, at the center of gravity.

A vehicle set down on rough ground touches it in (at least) three points whose triangle surrounds the center of gravity.
Among all planes that lie on or above every sample, the rest plane is the one that is lowest under the center of
gravity: a linear program in three unknowns, whose optimum is the facet of the samples' upper convex hull there. The
dual says the same: of all triangles of samples around the center, the one that carries it highest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.geometry.portable import hypot
from hulldown.placement.simplex import above_planes, highest_triangles, opposite, planes

# A center exactly on a line through two samples (always so on a regular grid) leaves the triangle to chance and lets
# the simplex method cycle. Moved by these shares of the footprint, no line through two samples meets it.
NUDGE = np.array([1.0e-6, 1.0e-6 * (math.sqrt(5.0) - 1) / 2])
TIED = 1e-4  # least share of the weight on a sample; below it the center counts as on an edge
OTHER_WAYS = np.array([[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


@dataclass(frozen=True, eq=False, slots=True)
class Rest:
    """Rest planes z = height + gradient . (x, y) about the vehicle's origin, in frames turned by the headings.

    `margin` is how far the center lies inside the triangle of three contacts; nan for rules without contacts. Where it
    is 0, the center is right above a contact, or between two, and the plane may tip several ways; it is then the mean
    of those, which touches that contact or those two.
    """

    height: Float[np.ndarray, " n"]
    gradient: Float[np.ndarray, "n 2"]
    found: Bool[np.ndarray, " n"]
    margin: Float[np.ndarray, " n"]


def support_plane(
    samples_xy: Float[np.ndarray, "m 2"], heights: Float[np.ndarray, "n m"], valid: Bool[np.ndarray, "n m"]
) -> Rest:
    """Return the lowest plane above all valid samples, for each row of heights."""
    n = len(heights)
    coefficients, margin = np.full((n, 3), np.nan), np.full(n, np.nan)
    if not valid.all():
        heights = np.where(valid, heights, -np.inf)
    # Relative to the highest sample, so that rounding scales with the relief and not with the altitude.
    top = heights.max(axis=1, initial=-np.inf)
    top[np.isneginf(top)] = 0.0
    heights = heights - top[:, None]
    nudge = NUDGE * np.ptp(samples_xy, axis=0) if len(samples_xy) else NUDGE
    contacts = highest_triangles(samples_xy, heights, nudge)
    found = contacts[:, 0] >= 0
    rows = np.flatnonzero(found)
    if len(rows) < n:
        heights = heights[rows]
    basis = contacts[rows]
    corners = samples_xy[basis]
    plane = planes(corners, np.take_along_axis(heights, basis, axis=1))
    weight = np.abs(opposite(corners, np.zeros((1, 2))))
    side = corners[:, (1, 2, 0)] - corners[:, (2, 0, 1)]
    margin[rows] = (weight / hypot(side[..., 0], side[..., 1])).min(axis=1)
    idle = weight < TIED * weight.sum(axis=1, keepdims=True)
    ties = idle.sum(axis=1)
    edge, above_contact = np.flatnonzero(ties == 1), np.flatnonzero(ties == 2)
    plane[edge] = _over_an_edge(samples_xy, heights[edge], basis[edge], np.argmax(idle[edge], axis=1), plane[edge])
    plane[above_contact] = _over_one_contact(samples_xy, heights[above_contact], nudge, plane[above_contact])
    coefficients[rows] = plane
    return Rest(coefficients[:, 2] + top, coefficients[:, :2], found, margin)


def _over_an_edge(
    samples_xy: Float[np.ndarray, "m 2"],
    heights: Float[np.ndarray, "n m"],
    basis: Int[np.ndarray, "n 3"],
    idle: Int[np.ndarray, " n"],
    plane: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Return the mean of the plane and of what it becomes when tipped over the two contacts that carry everything.

    Tipped away from the idle contact, it first meets the sample that is least below it for its distance from the edge.
    """
    a, b = (basis[np.arange(len(basis)), (idle + turn) % 3] for turn in (1, 2))
    x, y = np.ascontiguousarray(samples_xy.T)
    along_x, along_y = x[b] - x[a], y[b] - y[a]
    beyond = along_y[:, None] * x
    beyond -= along_x[:, None] * y
    beyond -= (along_y * x[a] - along_x * y[a])[:, None]
    below = -above_planes(samples_xy, heights, plane)
    slope = np.full(below.shape, np.inf)
    # Samples on the edge's own line are beyond it by rounding at most.
    np.divide(below, beyond, out=slope, where=beyond > (1e-9 * (along_x**2 + along_y**2))[:, None])
    third = np.argmin(slope, axis=1)
    some = np.flatnonzero(np.isfinite(slope[np.arange(len(third)), third]))
    other = np.stack([b, a, third], axis=1)[some]
    mean = plane.copy()
    mean[some] += planes(samples_xy[other], np.take_along_axis(heights[some], other, axis=1))
    mean[some] /= 2
    return mean


def _over_one_contact(
    samples_xy: Float[np.ndarray, "m 2"],
    heights: Float[np.ndarray, "n m"],
    nudge: Float[np.ndarray, "2"],
    plane: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Return the mean of the planes that a nudge of the center to each of four sides gives; the first is known.

    A sample right below the center (there is one wherever n is odd and the ground is convex) can be tipped about in any
    direction: one of them, taken at random, would be further from the truth than their mean.
    """
    total, ways = plane.copy(), np.ones((len(plane), 1))
    for way in OTHER_WAYS:
        nudged = highest_triangles(samples_xy, heights, way * nudge)
        some = np.flatnonzero(nudged[:, 0] >= 0)
        total[some] += planes(samples_xy[nudged[some]], np.take_along_axis(heights[some], nudged[some], axis=1))
        ways[some] += 1
    return total / ways
