"""World points to pixels, and pixels to rays, for one or many cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from hulldown.camera.intrinsics import Intrinsics
from hulldown.geometry.arrays import checked
from hulldown.geometry.transforms import apply, invert_rigid, rotate

NEAR_M = 0.1  # meters along the optical axis; nothing closer is seen: boxes are clipped here and so are renders


class Projected(NamedTuple):
    """Projected points."""

    pixels: Float[np.ndarray, "... n 2"]  # continuous, may lie outside the image; nan where depth <= 0
    depth: Float[np.ndarray, "... n"]  # meters along the optical axis; negative behind the camera


def project(intrinsics: Intrinsics, world_from_camera: ArrayLike, points_world: ArrayLike) -> Projected:
    """Return pixels and depths of world points.

    Parameters
    ----------
    intrinsics
        One camera for all, or one for each of m poses (m, 4, 4).
    world_from_camera
        (..., 4, 4) rigid poses: x right, y down, z forward.
    points_world
        (..., n, 3) meters; leading axes broadcast against those of the poses.

    Returns
    -------
    Projected
        pixels (..., n, 2) and depth (..., n). The pixel of a point at or behind the
        camera's plane is nan.
    """
    return project_camera(intrinsics, apply(invert_rigid(world_from_camera), points_world))


def project_camera(intrinsics: Intrinsics, points_camera: ArrayLike) -> Projected:
    """Project points (..., n, 3) of the camera's frame."""
    points = checked(points_camera, "points_camera", ("...", "n", 3), finite=False)
    depth = points[..., 2]
    ahead = np.where(depth > 0.0, depth, np.nan)[..., None]
    # Just in front of the plane the quotient may overflow to infinity, the right limit.
    with np.errstate(over="ignore"):
        return Projected(intrinsics.pixels(points[..., :2] / ahead), depth)


def directions(intrinsics: Intrinsics, pixels: ArrayLike) -> Float[np.ndarray, "... n 3"]:
    """Camera-frame directions (..., n, 3) through pixels (..., n, 2), with z = 1: depth times them is the point."""
    uv = checked(pixels, "pixels", ("...", "n", 2), finite=False)
    unit = intrinsics.at_unit_depth(uv)
    through = np.ones((*unit.shape[:-1], 3))
    through[..., :2] = unit
    return through


@dataclass(frozen=True, eq=False, slots=True)
class Camera:
    """One camera somewhere in the world.

    Examples
    --------
    >>> import math
    >>> import numpy as np
    >>> from hulldown.camera.intrinsics import Intrinsics
    >>> camera = Camera(Intrinsics(640, 480, math.pi / 2), np.eye(4))  # at the origin, looking along +z
    >>> pixels, depth = camera.project([[0.0, 0.0, 10.0], [1.0, 0.5, 10.0], [0.0, 0.0, -1.0]])
    >>> pixels.round(6).tolist(), depth.tolist()
    ([[320.0, 240.0], [352.0, 256.0], [nan, nan]], [10.0, 10.0, -1.0])
    """

    intrinsics: Intrinsics  # image size and field of view
    world_from_camera: np.ndarray  # rigid pose; camera axes x right, y down, z forward (OpenCV)

    def __post_init__(self) -> None:
        pose = checked(self.world_from_camera, "world_from_camera", (4, 4))
        rotation = pose[:3, :3]
        rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0.0
        if not rigid or not np.array_equal(pose[3], [0.0, 0.0, 0.0, 1.0]):
            raise ValueError(f"world_from_camera: expected a rigid 4x4 transform, got {pose.tolist()}")
        object.__setattr__(self, "world_from_camera", pose)

    @property
    def camera_from_world(self) -> Float[np.ndarray, "4 4"]:
        """The inverse pose."""
        return invert_rigid(self.world_from_camera)

    @property
    def position(self) -> Float[np.ndarray, "3"]:
        """The camera's position in the world."""
        return self.world_from_camera[:3, 3]

    def project(self, points_world: ArrayLike) -> Projected:
        """Return pixels (n, 2) and depth (n,) of world points (n, 3); pixels are nan at or behind the camera."""
        return project(self.intrinsics, self.world_from_camera, points_world)

    def ray_directions(self, pixels: ArrayLike) -> Float[np.ndarray, "n 3"]:
        """World unit directions of the rays through `pixels` (n, 2); all start at `position`."""
        through = directions(self.intrinsics, pixels)
        through /= np.linalg.norm(through, axis=-1, keepdims=True)
        return rotate(self.world_from_camera[:3, :3], through)
