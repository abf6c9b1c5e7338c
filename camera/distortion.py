"""Brown-Conrady lens distortion in OpenCV's form, its inverse, and the radius at which it folds.

A point (x, y) of the plane at unit depth, at the distance r from the axis, goes to

    x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2),
    y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y,

which is the gradient of a potential: its Jacobian is symmetric. With q = |(p1, p2)|, no eigenvalue of the Jacobian
within a disk is below the least of g(r) - 6 q r, where g is the derivative of the radial part, r (1 + k1 r^2 + ...). Up
to the first r at which that is zero the potential is convex, so no two points of the disk go to the same place.

Coefficients are in OpenCV's order: k1, k2, p1, p2, k3. Runs in Blender too, which may have numpy only.

D. C. Brown, Close-range camera calibration, Photogrammetric Engineering 37(8), 1971. OpenCV, Camera Calibration and 3D
Reconstruction: the formula above.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
SEEN_FOLD_SHARE = 0.999  # share of the fold's radius that is seen: at the fold itself, a pixel's ray isn't defined
MAX_NEWTON_STEPS = 60  # Newton's method takes 4 to 8, and more only near the fold
MAX_INVERSE_RESIDUAL = 1e-13  # relative
IMAGE_SIDE_SAMPLES = 64  # points on each side of an image, for its bounds at unit depth

Coefficients = tuple[float, float, float, float, float]


def distort_points(points: np.ndarray, distortion: Coefficients, radius: float = math.inf) -> np.ndarray:
    """Distort points (..., 2) of the plane at unit depth; nan beyond the visible radius, see `max_seen_radius`."""
    x, y = points[..., 0], points[..., 1]
    k1, k2, p1, p2, k3 = distortion
    square = x * x + y * y
    with np.errstate(over="ignore", invalid="ignore"):  # infinity is outside the image
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        across = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
        down = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.where((square <= radius * radius)[..., None], np.stack([across, down], -1), np.nan)


def distortion_jacobian(points: np.ndarray, distortion: Coefficients) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the three different entries of the symmetric Jacobian of `distort_points`: xx, xy, yy."""
    x, y = points[..., 0], points[..., 1]
    k1, k2, p1, p2, k3 = distortion
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    slope = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))
    return (
        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
    )


def max_second_derivative(length: np.ndarray, distortion: Coefficients) -> np.ndarray:
    """Return the greatest second derivative of `distort_points` along lines at unit speed, `length` off the axis."""
    k1, k2, p1, p2, k3 = map(abs, distortion)
    square = length * length
    first = k1 + square * (2.0 * k2 + square * 3.0 * k3)
    second = 2.0 * k2 + square * 6.0 * k3
    return length * (6.0 * first + 4.0 * square * second) + 6.0 * math.sqrt(p1 * p1 + p2 * p2)


def undistort_points(points: np.ndarray, distortion: Coefficients, radius: float) -> np.ndarray:
    """Return the points that `distort_points` takes to these, each by its own Newton's method; nan if there is none."""
    wanted = np.asarray(points, dtype=np.float64)
    target = wanted.reshape(-1, 2)
    at = _clamp_radius(target, radius)
    off = distort_points(at, distortion) - target
    miss = _axis_distance(off)
    close = MAX_INVERSE_RESIDUAL * (1.0 + _axis_distance(target))
    share = np.ones(len(target))
    active = np.flatnonzero(np.isfinite(miss) & (miss > 0.0))
    for _ in range(MAX_NEWTON_STEPS):
        if not len(active):
            break
        xx, xy, yy = distortion_jacobian(at[active], distortion)
        u, v = off[active, 0], off[active, 1]
        scale = share[active] / (xx * yy - xy * xy)
        step = np.stack([(yy * u - xy * v) * scale, (xx * v - xy * u) * scale], -1)
        tried = _clamp_radius(at[active] - step, radius)
        tried_off = distort_points(tried, distortion) - target[active]
        tried_miss = _axis_distance(tried_off)
        better = tried_miss < miss[active]
        rows = active[better]
        at[rows], off[rows], miss[rows] = tried[better], tried_off[better], tried_miss[better]
        share[active] = np.where(better, 1.0, share[active] / 2.0)
        # A point is done when it is close and no step brings it closer.
        active = active[(better & (tried_miss > 0.0)) | (~better & (miss[active] > close[active]))]
    return np.where((miss <= close)[:, None], at, np.nan).reshape(wanted.shape)


@lru_cache(maxsize=256)
def max_seen_radius(distortion: Coefficients) -> float:
    """Return the radius at unit depth up to which a lens sees, just before it folds; infinite if it never does."""
    k1, k2, p1, p2, k3 = distortion
    if not any(distortion):
        return math.inf
    tangential = -6.0 * math.sqrt(p1 * p1 + p2 * p2)
    folds = [
        float(root.real)
        for radial in ((7.0 * k3, 5.0 * k2, 3.0 * k1), (k3, k2, k1))
        for root in np.roots([radial[0], 0.0, radial[1], 0.0, radial[2], tangential, 1.0])
        # A double root, which rounding may have moved off the real axis, is a fold too.
        if root.real > 0.0 and abs(root.imag) <= 1e-6 * root.real
    ]
    return SEEN_FOLD_SHARE * min(folds, default=math.inf)


@lru_cache(maxsize=256)
def image_bounds_at_unit_depth(
    width: float, height: float, pinhole: tuple[float, float, float, float], distortion: Coefficients
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return corners of the smallest rectangle at unit depth around everything that an image shows."""
    fx, fy, cx, cy = pinhole
    pixels = (unit_square_side_points(IMAGE_SIDE_SAMPLES) * [width, height] - [cx, cy]) / [fx, fy]
    if not any(distortion):
        return tuple(pixels.min(axis=(0, 1)).tolist()), tuple(pixels.max(axis=(0, 1)).tolist())
    unit = undistort_points(pixels, distortion, max_seen_radius(distortion))
    if not np.isfinite(unit).all():
        raise ValueError(
            f"distortion: expected a lens that doesn't fold inside the image, got {distortion!r}, which folds at "
            f"{max_seen_radius(distortion) / SEEN_FOLD_SHARE:.3g} times the focal length"
        )
    # Between two places a side bulges by no more than an eighth of the second difference.
    bulge = np.abs(np.diff(unit, n=2, axis=1)).max(axis=(0, 1))
    return tuple((unit.min(axis=(0, 1)) - bulge).tolist()), tuple((unit.max(axis=(0, 1)) + bulge).tolist())


def unit_square_side_points(parts: int) -> np.ndarray:
    """Return points (4, parts + 1, 2) that cut each side of the unit square into equal parts, ends included."""
    t = np.linspace(0.0, 1.0, parts + 1)
    zero, one = np.zeros_like(t), np.ones_like(t)
    return np.array([[t, zero], [t, one], [zero, t], [one, t]]).transpose(0, 2, 1)


def _clamp_radius(points: np.ndarray, radius: float) -> np.ndarray:
    length = _axis_distance(points)
    with np.errstate(invalid="ignore"):
        return np.where((length > radius)[:, None], points * (radius / np.maximum(length, 1e-300))[:, None], points)


def _axis_distance(points: np.ndarray) -> np.ndarray:
    return np.sqrt(points[:, 0] * points[:, 0] + points[:, 1] * points[:, 1])
