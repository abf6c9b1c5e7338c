"""View frustums as half-spaces: the near plane and the image's edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from hulldown.camera.lenses import Lenses
from hulldown.camera.projection import NEAR

# Which planes a point is outside of, or lies on, as bits.
NEAR_BIT, LEFT_BIT, RIGHT_BIT, TOP_BIT, BOTTOM_BIT = 1, 2, 4, 8, 16


@dataclass(frozen=True, slots=True)
class Frustum:
    """A view frustum as half-spaces in the camera's frame.

    Parameters
    ----------
    focal, center, size
        Focal lengths, principal point, and image size in pixels.
    frame
        Whether the image's edges are among the half-spaces, or the near plane alone.
    """

    focal: tuple[float, float]
    center: tuple[float, float]
    size: tuple[float, float]
    frame: bool

    @classmethod
    def of(cls, lens: Lenses, *, frame: bool) -> Frustum:
        """The frustum of one camera."""
        focal, center, size = (tuple(each.tolist()) for each in (lens.focal, lens.center, lens.size))
        return cls(focal, center, size, frame)

    @property
    def _sides(self) -> tuple[float, float, float, float]:
        """Pixels from the principal point to the left, right, upper, and lower side of the image."""
        (cx, cy), (width, height) = self.center, self.size
        return cx, width - cx, cy, height - cy

    @property
    def bits(self) -> tuple[int, ...]:
        """The planes of this frustum, in the order of `planes`."""
        return (NEAR_BIT, LEFT_BIT, RIGHT_BIT, TOP_BIT, BOTTOM_BIT) if self.frame else (NEAR_BIT,)

    @property
    def planes(self) -> Float[np.ndarray, "k 4"]:
        """Rows (a, b, c, d) with a x + b y + c z + d >= 0 inside."""
        (fx, fy), (left, right, top, bottom) = self.focal, self._sides
        near = [0.0, 0.0, 1.0, -NEAR]
        if not self.frame:
            return np.array([near])
        return np.array(
            [near, [fx, 0.0, left, 0.0], [-fx, 0.0, right, 0.0], [0.0, fy, top, 0.0], [0.0, -fy, bottom, 0.0]]
        )

    def distance(self, bit: int, points: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "*n"]:
        """Signed distance of points to one plane, scaled; not negative inside."""
        x, y, z = points
        (fx, fy), (left, right, top, bottom) = self.focal, self._sides
        if bit == NEAR_BIT:
            return z - NEAR
        if bit == LEFT_BIT:
            return fx * x + left * z
        if bit == RIGHT_BIT:
            return right * z - fx * x
        if bit == TOP_BIT:
            return fy * y + top * z
        return bottom * z - fy * y

    def outside(self, points: Float[np.ndarray, "3 *n"]) -> UInt8[np.ndarray, "*n"]:
        """For each point the bits of the planes that it is outside of."""
        code = np.zeros(points.shape[1:], dtype=np.uint8)
        for bit in self.bits:
            code |= (self.distance(bit, points) < 0.0).astype(np.uint8) * np.uint8(bit)
        return code

    def project(self, points: Float[np.ndarray, "3 *n"]) -> Float[np.ndarray, "2 *n"]:
        """Continuous pixels of points inside the frustum, clamped to the image against rounding."""
        x, y, z = points
        u = x / z * self.focal[0] + self.center[0]
        v = y / z * self.focal[1] + self.center[1]
        if self.frame:
            np.clip(u, 0.0, self.size[0], out=u)
            np.clip(v, 0.0, self.size[1], out=v)
        return np.stack([u, v])

    def beyond(self, box: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4 4"]:
        """Linear functions that are positive, in front of the camera, at what lies beyond each side of a box.

        Zero for sides that the image's edge has closed. Of an empty box everything in the image lies beyond.
        """
        (fx, fy), (cx, cy), (width, height) = self.focal, self.center, self.size
        u0, v0, u1, v1 = [width, height, 0.0, 0.0] if np.isinf(box).any() else box.tolist()
        rows = np.array(
            [[-fx, 0.0, u0 - cx, 0.0], [0.0, -fy, v0 - cy, 0.0], [fx, 0.0, cx - u1, 0.0], [0.0, fy, cy - v1, 0.0]]
        )
        if self.frame:
            rows[[u0 <= 0.0, v0 <= 0.0, u1 >= width, v1 >= height]] = 0.0
        return rows
