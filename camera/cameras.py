"""The table of cameras: lenses and poses together, which take world points to pixels, and pixels to rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.camera.intrinsics import Intrinsics, Projected
from hulldown.geometry.transforms import invert_rigid, rotate_vectors, transform_points

NEAR_M = 0.1  # depth along the optical axis at which boxes and renders are clipped
RIGID_TOLERANCE = 1e-6 + 1e-5 * np.eye(3)  # for the products of a pose's axes


@dataclass(frozen=True, eq=False, slots=True)
class Cameras:
    """One camera, or n cameras in rows.

    Parameters
    ----------
    lenses
        Image size, and field of view or calibration: one for all cameras, or one for each.
    world_from_camera
        (4, 4) rigid pose of one camera, or (n, 4, 4); camera axes x right, y down, z forward (OpenCV).

    Raises
    ------
    ValueError
        Naming the parameter.

    Examples
    --------
    >>> import math
    >>> import numpy as np
    >>> from hulldown.camera.intrinsics import Intrinsics
    >>> camera = Cameras(Intrinsics(640, 480, math.pi / 2), np.eye(4))  # at the origin, looking along +z
    >>> pixels, depth = camera.project([[0.0, 0.0, 10.0], [1.0, 0.5, 10.0], [0.0, 0.0, -1.0]])
    >>> pixels.round(6).tolist(), depth.tolist()
    ([[320.0, 240.0], [352.0, 256.0], [nan, nan]], [10.0, 10.0, -1.0])
    """

    lenses: Intrinsics
    world_from_camera: Float[np.ndarray, "*n 4 4"]

    def __post_init__(self) -> None:
        poses = checked_array(self.world_from_camera, "world_from_camera", ("...", 4, 4))
        x, y, z = (poses[..., :3, axis] for axis in range(3))
        products = np.einsum("...ij,...ik->...jk", poses[..., :3, :3], poses[..., :3, :3])
        rigid = (np.abs(products - np.eye(3)) <= RIGID_TOLERANCE).all(axis=(-1, -2))
        rigid &= ((np.cross(x, y) * z).sum(axis=-1) > 0.0) & (poses[..., 3, :] == [0.0, 0.0, 0.0, 1.0]).all(axis=-1)
        if not rigid.all():
            bad = poses[~rigid][0].tolist()
            raise ValueError(f"world_from_camera: expected a rigid 4x4 transform, got {bad}")
        if self.lenses.count not in (None, *poses.shape[:-2]):
            raise ValueError(f"lenses: expected one, or one for each pose {poses.shape[:-2]}, got {self.lenses.count}")
        object.__setattr__(self, "world_from_camera", poses)

    def __len__(self) -> int:
        return len(self.world_from_camera)

    @property
    def camera_from_world(self) -> Float[np.ndarray, "*n 4 4"]:
        """The inverse poses."""
        return invert_rigid(self.world_from_camera)

    @property
    def position(self) -> Float[np.ndarray, "*n 3"]:
        """Positions in the world."""
        return self.world_from_camera[..., :3, 3]

    def take(self, rows: Int[np.ndarray, " k"] | slice) -> Cameras:
        """Return some rows of n cameras, possibly repeated."""
        return _unchecked_cameras(self.lenses.take(rows), self.world_from_camera[rows])

    def with_poses(self, world_from_camera: Float[np.ndarray, "*n 4 4"]) -> Cameras:
        """Return the same lenses in other rigid poses, which aren't checked."""
        return _unchecked_cameras(self.lenses, world_from_camera)

    def project(self, points_world: ArrayLike) -> Projected:
        """Return pixels and depths of world points.

        Parameters
        ----------
        points_world
            (..., k, 3) meters; leading axes broadcast against those of the poses.

        Returns
        -------
        pixels (..., k, 2) and depth (..., k). The pixel of a point at or behind a camera's plane is nan.
        """
        points = checked_array(points_world, "points_world", ("...", "k", 3), finite=False)
        return self.lenses.project_points(transform_points(self.camera_from_world, points))

    def rays(self, pixels: ArrayLike) -> tuple[Float[np.ndarray, "*n k 3"], Float[np.ndarray, "*n k 3"]]:
        """Return the rays through pixels.

        Parameters
        ----------
        pixels
            (..., k, 2); leading axes broadcast against those of the poses.

        Returns
        -------
        origins and unit directions (..., k, 3) in the world; origins are the cameras' positions.
        """
        along = self.lenses.pixel_directions(checked_array(pixels, "pixels", ("...", "k", 2), finite=False))
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        along = rotate_vectors(self.world_from_camera[..., :3, :3], along)
        return np.broadcast_to(self.position[..., None, :], along.shape), along


def _unchecked_cameras(lenses: Intrinsics, world_from_camera: Float[np.ndarray, "*n 4 4"]) -> Cameras:
    """Make cameras without checks."""
    cameras = object.__new__(Cameras)
    object.__setattr__(cameras, "lenses", lenses)
    object.__setattr__(cameras, "world_from_camera", world_from_camera)
    return cameras
