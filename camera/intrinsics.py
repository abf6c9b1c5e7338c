"""A camera's intrinsics: image size, field of view or calibration, and the distance at which a size fills a share.

Other folders ask cameras for pixels, rays, and bounds. Only `camera/` computes with fields of view and focal lengths.
This module runs in Blender too, which may have numpy only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hulldown.camera.distortion import NONE, frame_bounds

WHOLE = (int, np.integer)  # built once: building the union for each camera would take longer than the checks


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A camera: one with square pixels and its principal point at the image's center, or a calibrated one.

    Pixels are continuous: (0, 0) is the outer corner of the top-left pixel, (width, height) that of the bottom-right.

    Parameters
    ----------
    width, height
        Image size in pixels, at least 1.
    fov_x
        Horizontal field of view in radians, between 0 and pi.
    pinhole
        fx, fy, cx, cy in pixels of a calibrated camera, which replace `fov_x`; see `calibrated`.
    distortion
        k1, k2, p1, p2, k3 of a calibrated camera; see `camera.distortion`.

    Raises
    ------
    ValueError
        Naming the parameter. A lens that folds inside the image is refused.

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
    pinhole: tuple[float, float, float, float] | None = None
    distortion: tuple[float, float, float, float, float] = NONE

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, WHOLE) or value < 1:
                raise ValueError(f"{name}: expected a whole number of pixels, at least 1, got {value!r}")
        if not 0.0 < self.fov_x < math.pi:
            raise ValueError(f"fov_x: expected radians between 0 and pi, got {self.fov_x!r}")
        object.__setattr__(self, "distortion", tuple(self.distortion))  # lists, from JSON
        if self.pinhole is not None:
            object.__setattr__(self, "pinhole", tuple(self.pinhole))
            if len(self.pinhole) != 4 or not (self.pinhole[0] > 0.0 and self.pinhole[1] > 0.0):
                raise ValueError(f"pinhole: expected positive fx and fy, cx, and cy, got {self.pinhole!r}")
            if len(self.distortion) != 5:
                raise ValueError(f"distortion: expected k1, k2, p1, p2, and k3, got {self.distortion!r}")
            self.bounds  # noqa: B018  # a lens that folds is refused

    @classmethod
    def calibrated(
        cls, width: int, height: int, pinhole: Sequence[float], distortion: Sequence[float] = NONE
    ) -> Intrinsics:
        """Return the intrinsics of a calibrated camera.

        Parameters
        ----------
        width, height
            Image size in pixels.
        pinhole
            fx, fy, cx, cy in pixels.
        distortion
            k1, k2, p1, p2, k3 in OpenCV's order.

        Examples
        --------
        >>> camera = Intrinsics.calibrated(1920, 1080, (1420.0, 1418.5, 964.2, 545.7), (-0.21, 0.07, 3e-4, -1e-4, 0.0))
        >>> camera.matrix.tolist()
        [[1420.0, 0.0, 964.2], [0.0, 1418.5, 545.7], [0.0, 0.0, 1.0]]
        """
        fx, fy, cx, cy = pinhole
        if not (fx > 0.0 and fy > 0.0):
            raise ValueError(f"pinhole: expected positive fx and fy, got {fx!r} and {fy!r}")
        fov_x = math.atan(cx / fx) + math.atan((width - cx) / fx)
        k1, k2, p1, p2, k3 = distortion
        return cls(width, height, fov_x, (fx, fy, cx, cy), (k1, k2, p1, p2, k3))

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> Intrinsics:
        """Return the intrinsics in a row or an image record: `width`, `height`, and `K` and `dist`, or `fov_x_deg`."""
        width, height, matrix = record["width"], record["height"], record.get("K")
        if matrix is None:
            return cls(width, height, math.radians(record["fov_x_deg"]))
        (fx, _, cx), (_, fy, cy), _ = matrix
        return cls.calibrated(width, height, (fx, fy, cx, cy), record.get("dist") or NONE)

    def resized(self, width: int, height: int) -> Intrinsics:
        """Return the same view in an image of another size."""
        if self.pinhole is None:
            return replace(self, width=width, height=height)
        across, down = width / self.width, height / self.height
        fx, fy, cx, cy = self.pinhole
        pinhole = (fx * across, fy * down, cx * across, cy * down)
        return replace(self, width=width, height=height, pinhole=pinhole)

    @property
    def aspect(self) -> float:
        """Width over height (eq 2)."""
        return self.width / self.height

    @property
    def fov_y(self) -> float:
        """Vertical field of view in radians (eq 3), of a camera that isn't calibrated."""
        return 2.0 * math.atan(self.half_tangents[1])

    @property
    def half_tangents(self) -> tuple[float, float]:
        """Half the width and height at unit depth of the smallest centered image that holds this one."""
        if self.pinhole is not None:
            low, high = self.bounds
            return max(-low[0], high[0]), max(-low[1], high[1])
        half = math.tan(self.fov_x / 2.0)
        return half, half * self.height / self.width

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest (x / z, y / z) of what a calibrated camera sees."""
        assert self.pinhole is not None
        return frame_bounds(self.width, self.height, self.pinhole, self.distortion)

    @property
    def f_px(self) -> float:
        """Focal length in pixels (eq 4), along x."""
        if self.pinhole is not None:
            return self.pinhole[0]
        from hulldown.geometry.portable import tan  # needs more than numpy

        # The same number as eq 4, (height / 2) / tan(fov_y / 2), without the digits that going through fov_y costs.
        return self.width / 2.0 / tan(self.fov_x / 2.0)

    @property
    def focal(self) -> tuple[float, float]:
        """Focal lengths fx and fy in pixels."""
        return (self.f_px,) * 2 if self.pinhole is None else self.pinhole[:2]

    @property
    def center(self) -> np.ndarray:
        """(2,) the principal point in pixels."""
        if self.pinhole is not None:
            return np.array(self.pinhole[2:])
        return np.array([self.width / 2.0, self.height / 2.0])

    @property
    def matrix(self) -> np.ndarray:
        """K (3, 3): takes camera coordinates (x right, y down, z forward) to homogeneous pixels before distortion."""
        (fx, fy), (cx, cy) = self.focal, self.center
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def distance_for(self, size: ArrayLike, target_fraction: ArrayLike) -> np.ndarray:
        """Return the distance at which an upright `size` fills `target_fraction` of the image's height (eqs 5 and 6).

        Parameters
        ----------
        size
            (...) meters, positive; the paper takes the smallest dimension of the vehicle's bounding box.
        target_fraction
            (...) share of the image height, positive; may exceed 1.

        Returns
        -------
        (...) meters along the optical axis; the leading axes broadcast.
        """
        return face_on_distance(size, target_fraction, focal=self.focal[1], height=self.height)


def face_on_distance(size: ArrayLike, target_fraction: ArrayLike, *, focal: ArrayLike, height: ArrayLike) -> np.ndarray:
    """Return the distance of `Intrinsics.distance_for` from the vertical focal length and the height in pixels."""
    from hulldown.geometry.arrays import positive  # needs more than numpy

    fraction = positive(target_fraction, "target_fraction")
    return np.asarray(positive(size, "size") * np.asarray(focal) / (np.asarray(height) * fraction))
