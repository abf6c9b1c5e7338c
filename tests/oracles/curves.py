"""The box of triangles behind a distorting lens, by very many points: slow and simple."""

import math

import numpy as np

from hulldown.camera.distortion import seen_radius
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.lenses import lenses
from hulldown.camera.projection import NEAR
from hulldown.tests.oracles.clipping import clipped
from hulldown.tests.oracles.nearest import nearest_triangle

LENSES = {
    "barrel": (-0.3, 0.1, 0.0, 0.0, 0.0),
    "folding": (-0.2, 0.0, 0.0, 0.0, 0.0),
    "pincushion": (0.3, 0.2, 0.0, 0.0, 0.05),
    "tangential": (-0.1, 0.02, 0.02, -0.015, 0.0),
    "mustache": (-0.3, 0.25, 0.0, 0.0, -0.02),
    "calibrated": (-0.21, 0.07, 3e-4, -1e-4, 0.0),
}
# Points along an edge, points that refine one near the extremes, and the number of such refinements.
ALONG, FINER, ZOOMS = 4001, 41, 4


def dense_extent(triangles: np.ndarray, intrinsics: Intrinsics, *, frame: bool) -> np.ndarray | None:
    """Lowest u and v, highest u and v, of triangles (f, 3, 3) in the camera's frame; None if nothing is visible."""
    radius, size = seen_radius(intrinsics.distortion), np.array([intrinsics.width, intrinsics.height])
    found = [np.empty((0, 2))]

    def image(points):
        pixels = opencv(points, intrinsics)
        seen = (points**2).sum(axis=1) <= radius**2
        return pixels, seen & ((pixels >= 0) & (pixels <= size)).all(axis=1) if frame else seen

    def keep(points):
        pixels, seen = image(points)
        found.append(pixels[seen])

    rng = np.random.default_rng(0)
    for triangle in triangles:
        corners = np.array(clipped(triangle, [(0.0, 0.0, 1.0, -NEAR)])).reshape(-1, 3)
        flat = corners[:, :2] / corners[:, 2:]
        for start, end in zip(flat, np.roll(flat, -1, axis=0), strict=True):
            t = np.linspace(0, 1, ALONG)
            for _ in range(ZOOMS):
                pixels, seen = image(start + t[:, None] * (end - start))
                step = np.abs(np.diff(pixels, axis=0)).max(axis=1)
                fine = seen[1:] != seen[:-1]
                if frame:  # next to an image border, which the edge may touch between two points
                    low, high = np.minimum(pixels[1:], pixels[:-1]), np.maximum(pixels[1:], pixels[:-1])
                    room = 2 * step[:, None]
                    beside = (np.abs(np.stack([low, high, low - size, high - size])) < room).any(axis=(0, 2))
                    fine |= beside & ((low <= size + room) & (high >= -room)).all(axis=1) & (step > 0.002)
                for axis in (0, 1) if seen.any() else ():
                    some = np.flatnonzero(seen)
                    for at in (some[pixels[some, axis].argmin()], some[pixels[some, axis].argmax()]):
                        fine[max(0, at - 2) : at + 2] = True
                which = np.flatnonzero(fine)[:3000]
                between = t[which, None] + (t[which + 1] - t[which])[:, None] * np.linspace(0, 1, FINER)
                t = np.unique(np.concatenate([t, between.ravel()]))
            keep(start + t[:, None] * (end - start))
        for k in range(1, len(corners) - 1):
            a, b = np.sort(rng.random((2, 2000)), axis=0)[:, :, None]
            inside = a * corners[0] + (b - a) * corners[k] + (1 - b) * corners[k + 1]
            keep(inside[:, :2] / inside[:, 2:])
    if frame:
        corner = size * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
        found.append(corner[_met(triangles, lenses(intrinsics).at_unit_depth(corner * 1.0))])
    elif math.isfinite(radius):
        angle = np.linspace(0, 2 * math.pi, 40_001)
        circle = radius * np.stack([np.cos(angle), np.sin(angle)], 1)
        found.append(opencv(circle[_met(triangles, circle)], intrinsics))
    pixels = np.concatenate(found)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)]) if len(pixels) else None


def opencv(points: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Pixels of points at unit depth, by the formula in OpenCV's manual."""
    fx, fy, cx, cy = intrinsics.pinhole
    k1, k2, p1, p2, k3 = intrinsics.distortion
    x, y = points.T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([fx * u + cx, fy * v + cy], 1)


def _met(triangles, points):
    """Whether the rays through points at unit depth hit any triangle in front of the near plane."""
    return nearest_triangle(np.zeros(3), np.c_[points, np.ones(len(points))], triangles, after=NEAR)[1] >= 0
