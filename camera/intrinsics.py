"""Intrinsics of one or many cameras: image size, field of view or calibration, pixels, and the plane at unit depth.

Other folders ask cameras for pixels, rays, and bounds. Only `camera/` computes with fields of view and focal lengths.
This module runs in Blender too, which may have numpy only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hulldown.base.portable import arctan2, hypot, tan
from hulldown.camera.distortion import (
    NO_DISTORTION,
    distort_points,
    image_bounds_at_unit_depth,
    max_seen_radius,
    undistort_points,
    unit_square_side_points,
)

WHOLE_NUMBER_TYPES = (int, np.integer)  # built once: building the union for each camera would take longer than the checks
WINDOW_SIDE_PARTS = 8  # a window's image is measured at the ends of these parts of its sides


class Projected(NamedTuple):
    """Pixels and depths of points."""

    pixels: np.ndarray  # (..., k, 2) continuous, may be outside the image; nan where depth <= 0
    depth: np.ndarray  # (..., k) meters along the optical axis; negative behind the camera


@dataclass(frozen=True)
class Intrinsics:
    """A calibrated camera, or one or m cameras with square pixels and the principal point at the image's center.

    Pixels are continuous: (0, 0) is the outer corner of the top-left pixel, (width, height) that of the bottom-right.

    Parameters
    ----------
    width, height
        Image size in pixels, at least 1.
    fov_x
        Horizontal field of view in radians, between 0 and pi: a number, or (m,) of m cameras.
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
    >>> round(float(camera.f_px), 1)
    1662.8
    >>> round(float(camera.target_distance(2.4, 0.2)), 2)  # 2.4 m high, a fifth of the image's height
    18.48
    """

    width: int
    height: int
    fov_x: float | np.ndarray
    pinhole: tuple[float, float, float, float] | None = None
    distortion: tuple[float, float, float, float, float] = NO_DISTORTION

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, WHOLE_NUMBER_TYPES) or value < 1:
                raise ValueError(f"{name}: expected a whole number of pixels, at least 1, got {value!r}")
        possible = (self.fov_x > 0.0) & (self.fov_x < math.pi)
        if not (possible.all() if isinstance(possible, np.ndarray) else possible):
            raise ValueError(f"fov_x: expected radians between 0 and pi, got {self.fov_x!r}")
        object.__setattr__(self, "distortion", tuple(self.distortion))  # lists, from JSON
        if self.pinhole is not None:
            object.__setattr__(self, "pinhole", tuple(self.pinhole))
            if len(self.pinhole) != 4 or not (self.pinhole[0] > 0.0 and self.pinhole[1] > 0.0):
                raise ValueError(f"pinhole: expected positive fx and fy, cx, and cy, got {self.pinhole!r}")
            if len(self.distortion) != 5:
                raise ValueError(f"distortion: expected k1, k2, p1, p2, and k3, got {self.distortion!r}")
            self.window  # noqa: B018  # a lens that folds is refused

    @classmethod
    def calibrated(
        cls, width: int, height: int, pinhole: Sequence[float], distortion: Sequence[float] = NO_DISTORTION
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
    def from_record_fields(
        cls,
        width: int,
        height: int,
        *,
        fov_x_deg: float | None = None,
        K: Sequence[Sequence[float]] | None = None,
        dist: Sequence[float] | None = None,
    ) -> Intrinsics:
        """Return the intrinsics in the fields of a row or an image record: `K` and `dist`, or else `fov_x_deg`."""
        if K is not None:
            (fx, _, cx), (_, fy, cy), _ = K
            return cls.calibrated(width, height, (fx, fy, cx, cy), dist or NO_DISTORTION)
        if fov_x_deg is None:
            raise ValueError("fov_x_deg: expected a number of degrees, got None")
        return cls(width, height, math.radians(fov_x_deg))

    def with_size(self, width: int, height: int) -> Intrinsics:
        """Return the same view in an image of another size."""
        if self.pinhole is None:
            return replace(self, width=width, height=height)
        across, down = width / self.width, height / self.height
        fx, fy, cx, cy = self.pinhole
        pinhole = (fx * across, fy * down, cx * across, cy * down)
        return replace(self, width=width, height=height, pinhole=pinhole)

    @property
    def count(self) -> int | None:
        """Number of cameras; None if one is for all."""
        return len(self.fov_x) if isinstance(self.fov_x, np.ndarray) else None

    def take(self, rows: np.ndarray | slice | int) -> Intrinsics:
        """Return some rows, or one; unchanged if one camera is for all."""
        if not isinstance(self.fov_x, np.ndarray):
            return self
        taken = replace(self, fov_x=self.fov_x[rows])
        vars(taken)["focal"] = self.focal[rows]  # tangents aren't computed again
        return taken

    @property
    def half_tangents(self) -> tuple[float, float]:
        """Half the width and height at unit depth of the smallest centered image that holds this one."""
        if self.pinhole is None:
            half = math.tan(self.fov_x / 2.0)
            return half, half * self.height / self.width
        low, high = self.window
        across, down = np.maximum(-low, high).tolist()
        return across, down

    @cached_property
    def focal(self) -> np.ndarray:
        """(2,) or (m, 2) focal lengths fx and fy in pixels (eq 4)."""
        if self.pinhole is not None:
            return np.array(self.pinhole[:2])
        # The same number as (height / 2) / tan(fov_y / 2), without the digits that going through eqs 2 and 3 costs.
        f = self.width / 2.0 / tan(self.fov_x / 2.0)
        return np.stack([f, f], -1)

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "focal"}  # not another numpy's array

    @property
    def f_px(self) -> np.float64 | np.ndarray:
        """A number, or (m,): focal length in pixels, along x."""
        return self.focal[..., 0][()]

    @property
    def center(self) -> np.ndarray:
        """(2,) the principal point in pixels."""
        return np.array([self.width / 2.0, self.height / 2.0] if self.pinhole is None else self.pinhole[2:])

    @property
    def size(self) -> np.ndarray:
        """(2,) width and height in pixels."""
        return np.array([self.width, self.height], dtype=np.float64)

    @property
    def pixel_centers(self) -> np.ndarray:
        """(height * width, 2) the centers of all pixels, row by row."""
        pixel = np.arange(self.width * self.height)
        return np.stack([pixel % self.width, pixel // self.width], axis=1) + 0.5

    @property
    def matrix(self) -> np.ndarray:
        """K (3, 3): takes camera coordinates (x right, y down, z forward) to homogeneous pixels before distortion."""
        (fx, fy), (cx, cy) = self.focal, self.center
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def is_distorted(self) -> bool:
        """Whether the lens distorts."""
        return any(self.distortion)

    @property
    def lens_seen_radius(self) -> float:
        """Radius at unit depth that the lens sees; see `camera.distortion.max_seen_radius`."""
        return max_seen_radius(self.distortion)

    @property
    def window(self) -> tuple[np.ndarray, np.ndarray]:
        """(2,) or (m, 2) corners of the smallest rectangle at unit depth around the image."""
        focal, center = self.focal, self.center
        if not self.is_distorted:
            return -center / focal, (self.size - center) / focal
        bounds = image_bounds_at_unit_depth(self.width, self.height, (*focal.tolist(), *center.tolist()), self.distortion)
        return np.array(bounds[0]), np.array(bounds[1])

    @property
    def fov_x_deg(self) -> np.ndarray:
        """() or (m,) horizontal field of view in degrees, at the height of the principal point."""
        if self.pinhole is None:
            return np.asarray(np.degrees(self.fov_x))
        fx, _, left, cy = self.pinhole
        right = self.width - left
        if self.is_distorted:
            low, high = self.unit_points_from_pixels(np.array([[0.0, cy], [self.width, cy]]))[:, 0].tolist()
            left, right = -low * fx, high * fx
        return np.asarray(np.degrees(arctan2(left, fx) + arctan2(right, fx)))

    @property
    def sin_half_fov_x(self) -> np.ndarray:
        """() or (m,) sine of the angle between the axis and the image's farther side."""
        if self.is_distorted:
            half = self.half_tangents[0]
            return np.asarray(half / hypot(half, 1.0))
        half = max(self.center[0], self.width - self.center[0])
        return np.asarray(half / hypot(half, self.f_px))

    def pixels(self, unit: np.ndarray) -> np.ndarray:
        """Continuous pixels (..., n, 2) of points (x / z, y / z) at unit depth; nan beyond what the lens sees.

        Without distortion they are monotone along each axis.
        """
        if self.is_distorted:
            unit = distort_points(unit, self.distortion, self.lens_seen_radius)
        pixels = np.asarray(unit * self.focal[..., None, :])
        pixels += self.center
        return pixels

    def unit_points_from_pixels(self, pixels: np.ndarray) -> np.ndarray:
        """Return points (..., n, 2) at unit depth that project to these pixels; nan where there are none."""
        unit = (pixels - self.center) / self.focal[..., None, :]
        return undistort_points(unit, self.distortion, self.lens_seen_radius) if self.is_distorted else unit

    def project_points(self, points_camera: np.ndarray) -> Projected:
        """Project points (..., k, 3) of the camera's frame."""
        depth = points_camera[..., 2]
        ahead = np.where(depth > 0.0, depth, np.nan)[..., None]
        # Just in front of the plane the quotient may overflow to infinity, the right limit.
        with np.errstate(over="ignore"):
            return Projected(self.pixels(points_camera[..., :2] / ahead), depth)

    def pixel_directions(self, pixels: np.ndarray) -> np.ndarray:
        """Return directions (..., k, 3) in the camera's frame with z = 1: depth times them is the point."""
        unit = self.unit_points_from_pixels(pixels)
        through = np.ones((*unit.shape[:-1], 3))
        through[..., :2] = unit
        return through

    def window_pixel_bounds(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return corners (m, 2) in pixels of a box around each window's image, all of it if the lens sees less."""
        sides = unit_square_side_points(WINDOW_SIDE_PARTS)
        pixels = self.pixels(low[:, None] + (high - low)[:, None] * sides.reshape(-1, 2)).reshape(-1, *sides.shape)
        # Between two places a side bulges by about an eighth of the second difference.
        bulge = np.abs(np.diff(pixels, n=2, axis=2)).max(axis=(1, 2))
        first = np.maximum(pixels.min(axis=(1, 2)) - bulge, 0.0)
        last = np.minimum(pixels.max(axis=(1, 2)) + bulge, self.size)
        unseen = np.isnan(first).any(axis=1)
        first[unseen], last[unseen] = 0.0, self.size
        return first, last

    def target_distance(self, size: ArrayLike, target_fraction: ArrayLike) -> np.ndarray:
        """Return the distance at which an upright `size` fills `target_fraction` of the image's height (eqs 5 and 6).

        Parameters
        ----------
        size
            (...) meters, positive; the paper takes the smallest dimension of the vehicle's bounding box.
        target_fraction
            (...) share of the image height, positive; may exceed 1.

        Returns
        -------
        (...) meters along the optical axis; the leading axes broadcast, against those of the cameras too.
        """
        from hulldown.base.arrays import checked_positive_array  # needs more than numpy

        fraction = checked_positive_array(target_fraction, "target_fraction")
        return np.asarray(checked_positive_array(size, "size") * self.focal[..., 1] / (self.height * fraction))
