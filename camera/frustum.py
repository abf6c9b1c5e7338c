"""View frustums as half-spaces: the near plane and the image's edges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, UInt8

from hulldown.camera.cameras import NEAR_M
from hulldown.camera.intrinsics import Intrinsics

NEAR_PLANE = np.array([[0.0, 0.0, 1.0, -NEAR_M]])


@dataclass(frozen=True, eq=False)
class Frustum:
    """A view frustum as half-spaces in the camera's frame."""

    intrinsics: Intrinsics
    frame: bool  # whether the image's edges are among the half-spaces, or the near plane alone

    @cached_property
    def _numbers(self) -> tuple[list[float], list[float], list[float]]:
        return self.intrinsics.focal.tolist(), self.intrinsics.center.tolist(), self.intrinsics.size.tolist()

    @property
    def planes(self) -> Float[np.ndarray, "k 4"]:
        """Rows (a, b, c, d) with a x + b y + c z + d >= 0 inside: near, then left, right, upper, and lower side."""
        if not self.frame:
            return NEAR_PLANE
        (fx, fy), (cx, cy), (width, height) = self._numbers
        sides = [[fx, 0.0, cx, 0.0], [-fx, 0.0, width - cx, 0.0], [0.0, fy, cy, 0.0], [0.0, -fy, height - cy, 0.0]]
        return np.concatenate([NEAR_PLANE, sides])

    def outside_bits(self, points: Float[np.ndarray, "3 *n"]) -> UInt8[np.ndarray, "*n"]:
        """For each point as bits, in the order of `planes`, which planes it is outside of."""
        code = np.zeros(points.shape[1:], dtype=np.uint8)
        for i, plane in enumerate(self.planes):
            code |= (plane_distance(plane, points) < 0.0).astype(np.uint8) << np.uint8(i)
        return code

    def project(self, points: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "2 *n"]:
        """Continuous pixels of points inside the frustum, clamped to the image against rounding."""
        (x, y, z), (focal, center, size) = points, self._numbers
        u = x / z * focal[0] + center[0]
        v = y / z * focal[1] + center[1]
        if self.frame:
            np.clip(u, 0.0, size[0], out=u)
            np.clip(v, 0.0, size[1], out=v)
        return np.stack([u, v])


def plane_distance(plane: Float[np.ndarray, "4"], points: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "*n"]:
    """Signed distance of points from a plane, scaled; not negative inside."""
    terms = [factor * x for factor, x in zip(plane.tolist(), (*points, 1.0), strict=True) if factor]
    return sum(terms[1:], start=terms[0])
