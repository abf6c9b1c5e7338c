"""A pinhole camera's inside: image size, field of view, and the distance at which a size fills a share of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.geometry.arrays import checked
from hulldown.geometry.portable import hypot, sin_cos, tan

WHOLE = (int, np.integer)  # a union made anew for each camera of a plan would cost more than all it checks


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera with square pixels and its principal point at the image's centre.

    Pixels are continuous: (0, 0) is the outer corner of the top-left pixel, (width, height) that of the bottom-right.

    Parameters
    ----------
    width, height
        Image size in pixels, at least 1.
    fov_x
        Horizontal field of view in radians, between 0 and pi.

    References
    ----------
    Paper, equations 2 to 6.

    Examples
    --------
    >>> import math
    >>> camera = Intrinsics(width=1920, height=1080, fov_x=math.radians(60.0))
    >>> round(camera.f_px, 1), round(math.degrees(camera.fov_y), 1)
    (1662.8, 36.0)
    >>> round(float(camera.distance_for(2.4, 0.2)), 2)  # 2.4 m high, a fifth of the image's height
    18.48
    """

    width: int
    height: int
    fov_x: float

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, WHOLE) or value < 1:
                raise ValueError(f"{name}: expected a whole number of pixels, at least 1, got {value!r}")
        if not 0.0 < self.fov_x < math.pi:
            raise ValueError(f"fov_x: expected radians between 0 and pi, got {self.fov_x!r}")

    @property
    def aspect(self) -> float:
        """Width over height (eq 2)."""
        return self.width / self.height

    @property
    def fov_y(self) -> float:
        """Vertical field of view in radians (eq 3)."""
        return 2.0 * math.atan(math.tan(self.fov_x / 2.0) / self.aspect)

    @property
    def f_px(self) -> float:
        """Focal length in pixels (eq 4)."""
        # The same number as eq 4, (height / 2) / tan(fov_y / 2), without the digits that going through fov_y costs.
        return self.width / 2.0 / tan(self.fov_x / 2.0)

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """The principal point in pixels."""
        return np.array([self.width / 2.0, self.height / 2.0])

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """K: takes camera coordinates (x right, y down, z forward) to homogeneous pixels."""
        f = self.f_px
        return np.array([[f, 0.0, self.width / 2.0], [0.0, f, self.height / 2.0], [0.0, 0.0, 1.0]])

    def distance_for(self, size: ArrayLike, target_fraction: ArrayLike) -> Float[np.ndarray, "..."]:
        """Distance at which an upright, face-on `size` fills `target_fraction` of the image height (eqs 5 and 6).

        Parameters
        ----------
        size
            (...) metres, positive; the paper takes the smallest dimension of the vehicle's bounding box.
        target_fraction
            (...) share of the image height, positive; may exceed 1.

        Returns
        -------
        (...) metres along the optical axis; the leading axes broadcast.
        """
        return lenses(self).distance_for(size, target_fraction)


@dataclass(frozen=True, eq=False, slots=True)
class Lenses:
    """What projecting takes of one camera's intrinsics, or of m cameras', as arrays.

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
