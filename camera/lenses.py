"""Intrinsics of one or many cameras as arrays, which convert between pixels and the plane at unit depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.camera.distortion import distorted, frame_bounds, seen_radius, undistorted
from hulldown.camera.intrinsics import Intrinsics, face_on_distance
from hulldown.geometry.portable import arctan2, hypot, sin_cos

ALONG = 8  # parts of a window's side at whose ends its image is measured


@dataclass(frozen=True, eq=False, slots=True)
class Lenses:
    """The intrinsics of one camera, or of m cameras, as arrays.

    Parameters
    ----------
    focal
        (2,) or (m, 2) focal lengths fx and fy in pixels.
    center
        (2,) or (m, 2) principal point in pixels.
    size
        (2,) or (m, 2) width and height in pixels.
    distortion
        (5,) or (m, 5) k1, k2, p1, p2, k3; zeros: none.
    """

    focal: Float[np.ndarray, "... 2"]
    center: Float[np.ndarray, "... 2"]
    size: Float[np.ndarray, "... 2"]
    distortion: Float[np.ndarray, "... 5"]

    def rows(self, index: Int[np.ndarray, "*k"] | Bool[np.ndarray, " m"]) -> Lenses:
        """Select cameras; unchanged if there is one for all."""
        if self.focal.ndim == 1:
            return self
        return Lenses(self.focal[index], self.center[index], self.size[index], self.distortion[index])

    def spread(self, n: int) -> Lenses:
        """Repeat to n cameras."""
        return Lenses(*(np.broadcast_to(each, (n, each.shape[-1])) for each in self._fields))

    @property
    def _fields(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        return self.focal, self.center, self.size, self.distortion

    @classmethod
    def of(cls, width: int, height: int, fov_x: Float[np.ndarray, " m"]) -> Lenses:
        """Return cameras of one image size with these horizontal fields of view in radians."""
        sine, cosine = sin_cos(fov_x / 2.0)
        f = width / 2.0 / (sine / cosine)
        size = np.tile([float(width), float(height)], (len(fov_x), 1))
        return cls(np.stack([f, f], -1), size / 2.0, size, np.zeros((len(fov_x), 5)))

    @classmethod
    def unknown(cls, n: int) -> Lenses:
        """Return uninitialized intrinsics of n cameras."""
        nan = np.full((n, 2), np.nan)
        return cls(nan, nan.copy(), nan.copy(), np.zeros((n, 5)))

    def distance_for(self, size: ArrayLike, target_fraction: ArrayLike) -> Float[np.ndarray, "..."]:
        """As `Intrinsics.distance_for`, for each camera; sizes and shares broadcast against the m cameras."""
        return face_on_distance(size, target_fraction, focal=self.focal[..., 1], height=self.size[..., 1])

    @property
    def distorted(self) -> bool:
        """Whether any of the lenses distorts."""
        return bool(self.distortion.any())

    @property
    def radius(self) -> Float[np.ndarray, "..."]:
        """Radius at unit depth that each lens sees; see `camera.distortion.seen_radius`."""
        return np.array(
            [seen_radius(tuple(each)) for each in self.distortion.reshape(-1, 5).tolist()], dtype=np.float64
        ).reshape(self.distortion.shape[:-1])

    @property
    def window(self) -> tuple[Float[np.ndarray, "... 2"], Float[np.ndarray, "... 2"]]:
        """Corners of the smallest rectangle at unit depth around the image."""
        low, high = -self.center / self.focal, (self.size - self.center) / self.focal
        if not self.distorted:
            return low, high
        each = [
            frame_bounds(width, height, (fx, fy, cx, cy), tuple(distortion))
            for (fx, fy), (cx, cy), (width, height), distortion in zip(
                *(each.reshape(-1, each.shape[-1]).tolist() for each in self._fields), strict=True
            )
        ]
        bounds = np.array(each, dtype=np.float64).reshape(*self.size.shape[:-1], 2, 2)
        return bounds[..., 0, :], bounds[..., 1, :]

    @property
    def fov_x_deg(self) -> Float[np.ndarray, "..."]:
        """Horizontal field of view in degrees, at the height of the principal point."""
        fx, left = self.focal[..., 0], self.center[..., 0]
        right = self.size[..., 0] - left
        if self.distorted:
            ends = np.stack([self.center, self.center], -2)
            ends[..., 0] = np.stack([np.zeros_like(left), self.size[..., 0]], -1)
            at = self.at_unit_depth(ends)[..., 0]
            left, right = -at[..., 0] * fx, at[..., 1] * fx
        return np.asarray(np.degrees(arctan2(left, fx) + arctan2(right, fx)))

    def pixels(self, unit: Float[np.ndarray, "... n 2"]) -> Float[np.ndarray, "... n 2"]:
        """Continuous pixels of points (x / z, y / z) of the plane at unit depth; nan beyond what the lens sees.

        Without distortion they are monotone along each axis.
        """
        if self.distorted:
            unit = distorted(unit, self.distortion[..., None, :], self.radius[..., None])
        return unit * self.focal[..., None, :] + self.center[..., None, :]

    def at_unit_depth(self, pixels: Float[np.ndarray, "... n 2"]) -> Float[np.ndarray, "... n 2"]:
        """Return points (x / z, y / z) at unit depth that project to these pixels; nan where there are none."""
        unit = (pixels - self.center[..., None, :]) / self.focal[..., None, :]
        if self.distorted:
            unit = undistorted(unit, self.distortion[..., None, :], self.radius[..., None])
        return unit

    def image_of(
        self, low: Float[np.ndarray, "m 2"], high: Float[np.ndarray, "m 2"]
    ) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 2"]]:
        """Return corners in pixels of a box around the image of a window at unit depth, for each camera.

        It's the whole image if the lens doesn't see the whole window.
        """
        t = np.linspace(0.0, 1.0, ALONG + 1)
        zero, one = np.zeros_like(t), np.ones_like(t)
        sides = np.array([[t, zero], [t, one], [zero, t], [one, t]]).transpose(0, 2, 1)
        pixels = self.pixels(low[:, None] + (high - low)[:, None] * sides.reshape(-1, 2)).reshape(-1, *sides.shape)
        # Between two places a side bulges by about an eighth of the second difference.
        bulge = np.abs(np.diff(pixels, n=2, axis=2)).max(axis=(1, 2))
        first = np.maximum(pixels.min(axis=(1, 2)) - bulge, 0.0)
        last = np.minimum(pixels.max(axis=(1, 2)) + bulge, self.size)
        unseen = np.isnan(first).any(axis=1)
        first[unseen], last[unseen] = 0.0, self.size[unseen]
        return first, last

    @property
    def sin_half_fov_x(self) -> Float[np.ndarray, "..."]:
        """Sine of the angle between the axis and the image's farther side."""
        if self.distorted:
            low, high = self.window
            half = np.maximum(-low[..., 0], high[..., 0])
            return np.asarray(half / hypot(half, 1.0))
        half = np.maximum(self.center[..., 0], self.size[..., 0] - self.center[..., 0])
        return np.asarray(half / hypot(half, self.focal[..., 0]))


Optics = Intrinsics | Sequence[Intrinsics] | Lenses


def lenses(intrinsics: Optics) -> Lenses:
    """Return one camera's intrinsics or a row of them, as arrays."""
    if isinstance(intrinsics, Lenses):
        return intrinsics
    if isinstance(intrinsics, Intrinsics):
        return Lenses(*(each[0] for each in lenses([intrinsics])._fields))
    columns = [(i.focal, i.center, (i.width, i.height), i.distortion) for i in intrinsics]
    return Lenses(
        *(
            np.array([row[k] for row in columns], dtype=np.float64).reshape(-1, width)
            for k, width in enumerate((2, 2, 2, 5))
        )
    )
