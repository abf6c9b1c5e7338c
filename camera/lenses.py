"""Intrinsics of one camera or of many as arrays: between pixels and the plane at unit depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.camera.intrinsics import Intrinsics
from hulldown.geometry.arrays import checked
from hulldown.geometry.portable import arctan2, hypot, sin_cos


@dataclass(frozen=True, eq=False, slots=True)
class Lenses:
    """The intrinsics of one camera, or of m cameras, as arrays.

    Parameters
    ----------
    f
        () or (m,) focal length in pixels.
    size
        (2,) or (m, 2) width and height in pixels.
    """

    f: Float[np.ndarray, "..."]
    size: Float[np.ndarray, "... 2"]

    def rows(self, index: Int[np.ndarray, " k"] | Bool[np.ndarray, " m"]) -> Lenses:
        """Those of some of the cameras; the same where one stands for all."""
        return self if self.f.ndim == 0 else Lenses(self.f[index], self.size[index])

    def spread(self, n: int) -> Lenses:
        """One for each of n cameras."""
        return Lenses(np.broadcast_to(self.f, (n,)), np.broadcast_to(self.size, (n, 2)))

    @classmethod
    def of(cls, width: int, height: int, fov_x: Float[np.ndarray, " m"]) -> Lenses:
        """Cameras of one image size with these horizontal fields of view in radians."""
        sine, cosine = sin_cos(fov_x / 2.0)
        return cls(width / 2.0 / (sine / cosine), np.tile([float(width), float(height)], (len(fov_x), 1)))

    def distance_for(self, size: ArrayLike, target_fraction: ArrayLike) -> Float[np.ndarray, "..."]:
        """As `Intrinsics.distance_for`, for each camera; sizes and shares broadcast against the m cameras."""
        metres, fraction = _positive(size, "size"), _positive(target_fraction, "target_fraction")
        return np.asarray(metres * self.f / (self.size[..., 1] * fraction))

    @property
    def half_extent(self) -> Float[np.ndarray, "... 2"]:
        """Half the image's width and height at unit depth."""
        return self.size / 2.0 / self.f[..., None]

    @property
    def fov_x_deg(self) -> Float[np.ndarray, "..."]:
        """Horizontal field of view in degrees."""
        return np.degrees(2.0 * arctan2(self.size[..., 0] / 2.0, self.f))

    def pixels(self, unit: Float[np.ndarray, "... n 2"]) -> Float[np.ndarray, "... n 2"]:
        """Continuous pixels of points (x / z, y / z) of the plane at unit depth; monotone along each axis."""
        return unit * self.f[..., None, None] + self.size[..., None, :] / 2.0

    def at_unit_depth(self, pixels: Float[np.ndarray, "... n 2"]) -> Float[np.ndarray, "... n 2"]:
        """Points (x / z, y / z) of the plane at unit depth that project to these pixels."""
        return (pixels - self.size[..., None, :] / 2.0) / self.f[..., None, None]

    @property
    def sin_half_fov_x(self) -> Float[np.ndarray, "..."]:
        """Sine of half the horizontal field of view."""
        half = self.size[..., 0] / 2.0
        return np.asarray(half / hypot(half, self.f))


Optics = Intrinsics | Sequence[Intrinsics] | Lenses


def lenses(intrinsics: Optics) -> Lenses:
    """One camera's intrinsics or a row of them, as arrays."""
    if isinstance(intrinsics, Lenses):
        return intrinsics
    if isinstance(intrinsics, Intrinsics):
        return Lenses(np.asarray(intrinsics.f_px), np.array([intrinsics.width, intrinsics.height], dtype=np.float64))
    sizes = np.array([(i.width, i.height) for i in intrinsics], dtype=np.float64).reshape(-1, 2)
    return Lenses(np.array([i.f_px for i in intrinsics], dtype=np.float64), sizes)


def _positive(value: ArrayLike, name: str) -> np.ndarray:
    array = checked(value, name, ("...",))
    if (array <= 0.0).any():
        raise ValueError(f"{name}: expected positive numbers, got {float(array.min())}")
    return array
