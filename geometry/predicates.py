"""Exact predicates for float64 input: the side of a line that a point is on, and a triangle's height above a point.

Each is first computed in floating point with a proven bound on its error, and exactly where the bound doesn't decide.

Let u = 2⁻⁵³. The side of p on the line from a to b is the sign of (ax − px)(by − py) − (ay − py)(bx − px). With l and
r the two rounded products, Shewchuk's stage A (section 4.3) gives

    |fl(l − r) − exact| ≤ (3u + 16u²)(|l| + |r|),

so a larger |fl(l − r)| has the right sign. The bound gets 1e-250 more, far above any underflow. Otherwise:

1. A rounded difference is zero, or has a sign, exactly as the true one. If the signs of the two products differ, or
   one is zero, the answer follows. This decides points on axis-parallel edges and on vertices.
2. If all four differences are exact (TWO-DIFF's tail is zero, theorem 7), Dekker's product gives l = l₁ + l₂ and
   r = r₁ + r₂ without error (Dekker; theorem 18). Rounding is monotone, so l₁ ≠ r₁ orders l and r; if l₁ = r₁, l₂ and
   r₂ do. This decides diagonals of regular grids.
3. The rest is computed in Python's integers: every float64 is an integer times a power of two.

Shewchuk, Adaptive precision floating-point arithmetic and fast robust geometric predicates, Discrete & Computational
Geometry 18, 1997: the filter of section 4.3 (ORIENT2D, stage A) and the exact product of section 2.5.
Dekker, A floating-point technique for extending the available precision, Numerische Mathematik 18, 1971.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int8, Shaped

ROUNDING_ERROR = 2.0**-53  # half an ulp of 1: the relative error of one rounding
ORIENT_BOUND = (3.0 + 16.0 * ROUNDING_ERROR) * ROUNDING_ERROR
# Below this a product may have lost bits to underflow, and no bound that is relative to it holds.
MIN_EXACT_PRODUCT = 1e-250


def orientation_sign(
    ax: Float[np.ndarray, " n"],
    ay: Float[np.ndarray, " n"],
    bx: Float[np.ndarray, " n"],
    by: Float[np.ndarray, " n"],
    px: Float[np.ndarray, " n"],
    py: Float[np.ndarray, " n"],
) -> Int8[np.ndarray, " n"]:
    """Return the exact sign of the area of (a, b, p): 1 with p left of the line from a to b, 0 on it, -1 right of it.

    Exact for all coordinates within 1e100 in size.
    """
    apx, bpy, apy, bpx = ax - px, by - py, ay - py, bx - px
    left, right = apx * bpy, apy * bpx
    area = left - right
    size = np.abs(left) + np.abs(right)
    # A float64 difference is zero, or has a sign, just as the true one.
    left_sign, right_sign = np.sign(apx) * np.sign(bpy), np.sign(apy) * np.sign(bpx)
    certain = np.abs(area) > ORIENT_BOUND * size + MIN_EXACT_PRODUCT
    sign = np.where(certain, np.sign(area), left_sign - right_sign).clip(-1, 1).astype(np.int8)
    open_ = np.flatnonzero(~certain & (left_sign == right_sign) & (left_sign != 0))
    if len(open_):
        sign[open_] = _exact_orientation_sign(*(v[open_] for v in (ax, ay, bx, by, px, py)))
    return sign


def _exact_orientation_sign(
    ax: Float[np.ndarray, " n"],
    ay: Float[np.ndarray, " n"],
    bx: Float[np.ndarray, " n"],
    by: Float[np.ndarray, " n"],
    px: Float[np.ndarray, " n"],
    py: Float[np.ndarray, " n"],
) -> Int8[np.ndarray, " n"]:
    factors = [ax - px, by - py, ay - py, bx - px]
    left, left_tail = _product_and_tail(factors[0], factors[1])
    right, right_tail = _product_and_tail(factors[2], factors[3])
    # Rounding is monotone: unequal rounded products are ordered as the exact ones; equal ones, as their tails.
    sign = np.where(left != right, np.sign(left - right), np.sign(left_tail - right_tail)).astype(np.int8)
    exact = (np.abs(left) > MIN_EXACT_PRODUCT) & (np.abs(right) > MIN_EXACT_PRODUCT)
    for a, b, difference in ((ax, px, factors[0]), (by, py, factors[1]), (ay, py, factors[2]), (bx, px, factors[3])):
        exact &= _exact_difference_mask(a, b, difference)
    open_ = np.flatnonzero(~exact)
    if len(open_):
        (a_x, a_y, b_x, b_y, p_x, p_y), _ = exact_integers_and_exponent(*(v[open_] for v in (ax, ay, bx, by, px, py)))
        area = (a_x - p_x) * (b_y - p_y) - (a_y - p_y) * (b_x - p_x)
        sign[open_] = (area > 0).astype(np.int8) - (area < 0).astype(np.int8)
    return sign


def _exact_difference_mask(
    a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"], difference: Float[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    # Knuth's TWO-DIFF (Shewchuk, theorem 7 and section 2.3): the rounding error of a - b, itself without error.
    b_virtual = a - difference
    a_virtual = difference + b_virtual
    return ((a - a_virtual) + (b_virtual - b)) == 0.0


def _product_and_tail(
    a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    # Dekker's product with Veltkamp's split (Shewchuk, theorems 17 and 18): a * b = product + tail, without error.
    product = a * b
    a_high, a_low = _split_float(a)
    b_high, b_low = _split_float(b)
    return product, a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)


def _split_float(a: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    c = 134217729.0 * a  # 2**27 + 1
    high = c - (c - a)
    return high, a - high


def exact_integers_and_exponent(*values: Float[np.ndarray, " n"]) -> tuple[list[Shaped[np.ndarray, " n"]], int]:
    """Return float64 arrays as arrays of Python integers, and the power of two that all are multiples of."""
    mantissas, exponents = zip(*(np.frexp(v) for v in values), strict=True)
    lowest = min(int(np.min(e, where=m != 0, initial=2000)) for m, e in zip(mantissas, exponents, strict=True))
    whole = [np.ldexp(m, 53).astype(np.int64).astype(object) for m in mantissas]
    shift = [np.maximum(e - lowest, 0).astype(object) for e in exponents]
    return [w << s for w, s in zip(whole, shift, strict=True)], lowest - 53


def exact_height_fractions(
    corners: Float[np.ndarray, "n 3 3"], x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
) -> tuple[Shaped[np.ndarray, " n"], Shaped[np.ndarray, " n"]]:
    """Return the exact height of each triangle's plane at each point: integer numerators, positive denominators.

    The triangles must have an XY area. Dividing the integers rounds once, to the nearest float64.
    """
    (ax, ay, bx, by, cx, cy, px, py), _ = exact_integers_and_exponent(*corners[:, :, :2].reshape(-1, 6).T, x, y)
    (az, bz, cz), exponent = exact_integers_and_exponent(*corners[:, :, 2].T)
    a = (bx - px) * (cy - py) - (by - py) * (cx - px)
    b = (cx - px) * (ay - py) - (cy - py) * (ax - px)
    c = (ax - px) * (by - py) - (ay - py) * (bx - px)
    whole = a + b + c
    sign = np.where(whole < 0, -1, 1).astype(object)
    return (sign * (a * az + b * bz + c * cz)) << max(exponent, 0), (sign * whole) << max(-exponent, 0)


def exact_upward_normals(corners: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return unit upward normals of triangles that have an XY area, from exact cross products."""
    (ax, ay, az, bx, by, bz, cx, cy, cz), _ = exact_integers_and_exponent(*corners.reshape(-1, 9).T)
    x = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
    y = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
    z = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    sign = np.where(z < 0, -1, 1).astype(object)
    largest = np.maximum(np.maximum(abs(x), abs(y)), abs(z))
    cross = np.stack([sign * x / largest, sign * y / largest, sign * z / largest], axis=1).astype(np.float64)
    return cross / np.sqrt(np.einsum("ij,ij->i", cross, cross))[:, None]
