"""A pinhole camera's intrinsics: image size, field of view, and the distance at which a size fills a share of it.

Other folders ask cameras for pixels, rays, and bounds. Only `camera/` computes with fields of view and focal lengths.
This module runs in Blender too, which may have numpy only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

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

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> Intrinsics:
        """The intrinsics that a row or an image record states in `width`, `height`, and `fov_x_deg`."""
        return cls(record["width"], record["height"], math.radians(record["fov_x_deg"]))

    def resized(self, width: int, height: int) -> Intrinsics:
        """The same view in an image of another size."""
        return replace(self, width=width, height=height)

    @property
    def aspect(self) -> float:
        """Width over height (eq 2)."""
        return self.width / self.height

    @property
    def fov_y(self) -> float:
        """Vertical field of view in radians (eq 3)."""
        return 2.0 * math.atan(self.half_tangents[1])

    @property
    def half_tangents(self) -> tuple[float, float]:
        """Half the image's width and height at unit depth."""
        half = math.tan(self.fov_x / 2.0)
        return half, half * self.height / self.width

    @property
    def f_px(self) -> float:
        """Focal length in pixels (eq 4)."""
        from hulldown.geometry.portable import tan  # needs more than numpy

        # The same number as eq 4, (height / 2) / tan(fov_y / 2), without the digits that going through fov_y costs.
        return self.width / 2.0 / tan(self.fov_x / 2.0)

    @property
    def centre(self) -> np.ndarray:
        """(2,) the principal point in pixels."""
        return np.array([self.width / 2.0, self.height / 2.0])

    @property
    def matrix(self) -> np.ndarray:
        """K (3, 3): takes camera coordinates (x right, y down, z forward) to homogeneous pixels."""
        f = self.f_px
        return np.array([[f, 0.0, self.width / 2.0], [0.0, f, self.height / 2.0], [0.0, 0.0, 1.0]])

    def distance_for(self, size: ArrayLike, target_fraction: ArrayLike) -> np.ndarray:
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
        from hulldown.camera.lenses import lenses  # needs more than numpy

        return lenses(self).distance_for(size, target_fraction)
