"""Find the triangle of samples around a center with the highest plane there, for many rows of heights at once.

A linear program. The samples' positions are the same for every row, only their heights differ. So a table of
triangles around the center and of the shares in which their corners carry it is made once; one product with it names a
good triangle for every row, and the simplex method walks on from there. A row's answer doesn't depend on other rows:
the product is one of whole numbers, exact in whatever order it is summed up, and the rest goes row by row.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations

import numpy as np
from jaxtyping import Float, Float32, Int

MOST_PIVOTS = 500
STARTS = 13  # samples that make some eighty starting triangles: more cost more than the pivots that they save
# Heights and shares are rounded to so many steps: their products, and the sums of these, stay below 2^24, where float32
# holds every whole number.
STEPS = 1 << 11
FLAT = 1e-300  # meters of relief below which steps overflow float64, and heights count as equal
# The table's shares are those of a point so many times as far out as the center (which lies next to the origin), but on
# the same side of all lines through two samples of a small grid: next to a sample all triangles with this corner tie.
AHEAD = 2e4
# Rows multiplied at once: few enough that BLAS starts no threads of its own, which would wait for each other.
_ROWS = 128
# Which corner of a counter-clockwise triangle gives way to a new one, by which corners are to the left of the line from
# the center to the new one (bits 0, 1, 2): the one whose opposite side this line meets behind the center.
_LEAVING = np.array([0, 2, 0, 0, 1, 2, 1, 0])


def highest_triangles(
    samples_xy: Float[np.ndarray, "m 2"], heights: Float[np.ndarray, "n m"], center: Float[np.ndarray, "2"]
) -> Int[np.ndarray, "n 3"]:
    """Return the triangle of samples around the center that carries it highest; -1 where there is none.

    References
    ----------
    Dantzig, Linear Programming and Extensions, 1963, chapter 5 (simplex method, largest-coefficient rule).
    """
    few, triangles, shares = _starts(samples_xy.tobytes(), *center.tolist())
    if not len(triangles):
        return np.full((len(heights), 3), -1)
    high = heights.max(axis=1)
    missing = np.isneginf(heights)
    complete = not missing.any()
    low = heights.min(axis=1) if complete else np.where(missing, np.inf, heights).min(axis=1)
    span = high - low
    with np.errstate(invalid="ignore"):
        step = (heights[:, few] - low[:, None]) * (STEPS / np.where(span > FLAT, span, np.inf))[:, None]
    if not complete:
        step[missing[:, few]] = -2 * STEPS
    basis = triangles[_highest(np.rint(step), shares)]
    # Far below any step that matters, far above the rounding of a plane through three samples.
    tolerance = 1e-12 * (1e-3 + span)
    if complete:
        return _climb(samples_xy, heights, basis, center, tolerance)
    # First a triangle of real samples only: the same program with the missing ones one unit below the rest.
    some = np.flatnonzero(_any_of(missing, basis))
    basis[some] = _climb(samples_xy, -1.0 * missing[some], basis[some], center, np.full(len(some), 1e-12))
    inside = ~_any_of(missing, basis)
    basis[inside] = _climb(samples_xy, heights[inside], basis[inside], center, tolerance[inside])
    basis[~inside] = -1
    return basis


def _any_of(missing: np.ndarray, basis: Int[np.ndarray, "n 3"]) -> np.ndarray:
    return np.take_along_axis(missing, basis, axis=1).any(axis=1)


@lru_cache(maxsize=256)
def _starts(
    samples: bytes, x: float, y: float
) -> tuple[Int[np.ndarray, " s"], Int[np.ndarray, "t 3"], Float32[np.ndarray, "s t"]]:
    """Return some samples, the triangles of these around the center, and by how much each sample carries it in each."""
    samples_xy, center = np.frombuffer(samples).reshape(-1, 2), np.array([[x, y]])
    m = len(samples_xy)
    spread = np.rint(np.linspace(0, m - 1, min(m, STARTS))).astype(int)
    corner = ((-1, -1.1), (1, -1.1), (1, 1.1), (-1, 1.1))
    outermost = [np.argmax(a * samples_xy[:, 0] + b * samples_xy[:, 1]) for a, b in corner] if m else spread
    few = np.unique([*outermost, *spread])
    corners = np.array(list(combinations(range(len(few)), 3)), dtype=int).reshape(-1, 3)
    area = opposite(samples_xy[few[corners]], center).sum(axis=1)
    corners[area < 0] = corners[area < 0, ::-1]
    corners = corners[np.abs(area) > 1e-9 * np.abs(area).max(initial=0.0)]
    corners = corners[(opposite(samples_xy[few[corners]], center) > 0).all(axis=1)]
    shares = np.zeros((len(few), len(corners)), dtype=np.float32)
    ahead = opposite(samples_xy[few[corners]], AHEAD * center)
    ahead = np.clip(ahead / ahead.sum(axis=1, keepdims=True), 0, 1)
    np.put_along_axis(shares, corners.T, np.rint(STEPS * ahead.T).astype(np.float32), axis=0)
    return few, few[corners], shares


def _highest(steps: Float[np.ndarray, "n s"], shares: Float32[np.ndarray, "s t"]) -> Int[np.ndarray, " n"]:
    """Return which triangle carries the center highest; of equals the first."""
    n, s = steps.shape
    padded = np.zeros((-(-n // _ROWS), _ROWS, s), dtype=np.float32)
    padded.reshape(-1, s)[:n] = steps
    return (padded @ shares).reshape(-1, shares.shape[1])[:n].argmax(axis=1)


def _climb(
    samples_xy: Float[np.ndarray, "m 2"],
    heights: Float[np.ndarray, "n m"],
    basis: Int[np.ndarray, "n 3"],
    center: Float[np.ndarray, "2"],
    tolerance: Float[np.ndarray, " n"],
) -> Int[np.ndarray, "n 3"]:
    """Pivot each row's triangle until no sample is above its plane; samples at -inf never enter."""
    final = basis.copy()
    rows = np.arange(len(basis))
    for _ in range(MOST_PIVOTS):
        corners = samples_xy[basis]
        above = above_planes(samples_xy, heights, planes(corners, np.take_along_axis(heights, basis, axis=1)))
        entering = np.argmax(above, axis=1)
        on = np.flatnonzero(above[np.arange(len(rows)), entering] > tolerance)
        if not len(on):
            break
        rows, basis, corners, entering = rows[on], basis[on], corners[on], entering[on]
        if len(on) < len(heights):
            heights, tolerance = heights[on], tolerance[on]
        along = samples_xy[entering] - center
        left = along[:, :1] * (corners[..., 1] - center[1]) > along[:, 1:] * (corners[..., 0] - center[0])
        basis[np.arange(len(rows)), _LEAVING[left @ np.array([1, 2, 4])]] = entering
        final[rows] = basis
    return final


def planes(corners: Float[np.ndarray, "n 3 2"], heights: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Gradient and height at the origin of the plane through three points each."""
    x, y = corners[..., 0], corners[..., 1]
    ax, ay, az = x[:, 1] - x[:, 0], y[:, 1] - y[:, 0], heights[:, 1] - heights[:, 0]
    bx, by, bz = x[:, 2] - x[:, 0], y[:, 2] - y[:, 0], heights[:, 2] - heights[:, 0]
    area = ax * by - ay * bx
    plane = np.empty((len(corners), 3))
    plane[:, 0] = gx = (az * by - bz * ay) / area
    plane[:, 1] = gy = (bz * ax - az * bx) / area
    plane[:, 2] = heights[:, 0] - gx * x[:, 0] - gy * y[:, 0]
    return plane


def above_planes(
    samples_xy: Float[np.ndarray, "m 2"], heights: Float[np.ndarray, "n m"], plane: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n m"]:
    """Return how far each sample is above its row's plane."""
    # No matrix product: its rounding may depend on the number of rows, and here it may decide between triangles.
    x, y = np.ascontiguousarray(samples_xy.T)
    above = heights - plane[:, 2:]
    above -= plane[:, :1] * x
    above -= plane[:, 1:2] * y
    return above


def opposite(corners: Float[np.ndarray, "n 3 2"], points: Float[np.ndarray, "#n 2"]) -> Float[np.ndarray, "n 3"]:
    """Twice the area between a point (one each, or one for all) and the side opposite each corner of a triangle each.

    Barycentric coordinates, times twice the triangle's area: positive inside where the triangle is counter-clockwise.
    """
    x, y = corners[..., 0] - points[:, :1], corners[..., 1] - points[:, 1:]
    part = np.empty((len(corners), 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        part[:, i] = x[:, j] * y[:, k] - x[:, k] * y[:, j]
    return part
