"""What a vehicle must keep clear of: obstacles, and other vehicles.

Vehicles are tested as oriented boxes, grown by the clearance to the sides and upwards (not downwards: contact with the
ground is tested by settling). Obstacles are tested by their triangles. All predicates take stacks of poses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from assets.vehicle import VehicleShape
from geometry.arrays import checked
from geometry.instances import InstancedScene
from geometry.overlap import PAIRS, ROOM, SceneTouch, boxes_touch
from geometry.portable import sin_cos
from geometry.transforms import compose, invert_rigid, rigid


def _skyward(n: int) -> Float[np.ndarray, "n 3"]:
    """Straight up first, then directions spread evenly over the upper half of the sphere, from the top down.

    References
    ----------
    Vogel, A better way to construct the sunflower head, Mathematical Biosciences 44, 1979: the golden angle.
    """
    i = np.arange(n)
    z = 1.0 - i / (n - 0.5)
    sin, cos = sin_cos(i * (math.pi * (3.0 - math.sqrt(5.0))))
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * cos, flat * sin, z], axis=1)


SKYWARD = _skyward(48)


@dataclass(frozen=True, eq=False, slots=True)
class Extent:
    """Boxes that together hold a vehicle: one for each part, so that a long barrel does not widen the hull.

    Parameters
    ----------
    half
        (b, 3) half the sizes, metres.
    vehicle_from_box
        (b, 4, 4) rigid: the boxes' centres and axes in the vehicle frame.
    """

    half: Float[np.ndarray, "b 3"]
    vehicle_from_box: Float[np.ndarray, "b 4 4"]


def extent_of(shape: VehicleShape, articulation: Mapping[str, float] | None = None) -> Extent:
    """The boxes of a vehicle's parts, with the parts turned.

    Parameters
    ----------
    shape
        The vehicle.
    articulation
        Part name -> radians; what it does not name stays at rest.
    """
    low, high, poses = [], [], []
    for part, vehicle_from_part in enumerate(shape.vehicle_from_parts(articulation or {})):
        mine = shape.mesh.vertices[shape.mesh.faces[shape.vertex_part[shape.mesh.faces[:, 0]] == part].ravel()]
        if len(mine):
            low.append(mine.min(axis=0))
            high.append(mine.max(axis=0))
            poses.append(vehicle_from_part)
    return _boxed(np.stack([low, high], axis=1), np.array(poses))


class Obstacles:
    """The obstacles of a scenery, prepared for testing whether vehicles are clear of them. Built once, never changes.

    Parameters
    ----------
    scene
        All that is no ground and no vehicle.
    solid
        (k,) which instances count; by default all. Grass gives way.
    """

    def __init__(self, scene: InstancedScene, *, solid: Bool[np.ndarray, " k"] | None = None) -> None:
        self._scene, self._touch = scene, SceneTouch(scene, solid)

    def clear(
        self, extent: Extent | VehicleShape | ArrayLike, world_from_vehicle: ArrayLike, clearance: float = 0.0
    ) -> Bool[np.ndarray, " n"]:
        """Whether no obstacle comes near each pose; arguments as for `clear_of_obstacles`."""
        boxes, poses = _extent_of(extent), checked(world_from_vehicle, "world_from_vehicle", ("n", 4, 4), finite=False)
        known = np.isfinite(poses).all(axis=(1, 2))
        half, world_from_box = _grown(boxes, poses[known], clearance)
        clear = np.zeros(len(poses), dtype=bool)
        clear[known] = ~self._touch.touched(half, world_from_box).reshape(-1, len(boxes.half)).any(axis=1)
        return clear

    def touched(
        self, half: Float[np.ndarray, "n 3"], world_from_box: Float[np.ndarray, "n 4 4"]
    ) -> Bool[np.ndarray, " n"]:
        """Whether each box touches or is inside an obstacle; see `SceneTouch.touched`."""
        return self._touch.touched(half, world_from_box)

    def open_above(self, point: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether a ray from each point, upwards or level, meets no obstacle within `ROOM` metres.

        Parameters
        ----------
        point
            (n, 3) world. Inside a closed house, a boulder or a hall no ray finds a way out, and no light a way in.
        """
        found = np.zeros(len(point), dtype=bool)
        for begin, end in pairwise((0, 1, 5, len(SKYWARD))):
            left = np.flatnonzero(~found)
            origins = np.repeat(point[left], end - begin, axis=0)
            directions = np.tile(SKYWARD[begin:end], (len(left), 1))
            blocked = self._scene.occluded(origins, directions, max_distance=ROOM)
            found[left] = ~blocked.reshape(len(left), end - begin).all(axis=1)
        return found


def clear_of_obstacles(
    scene: InstancedScene,
    extent: Extent | VehicleShape | ArrayLike,
    world_from_vehicle: ArrayLike,
    clearance: float = 0.0,
    *,
    solid: Bool[np.ndarray, " k"] | None = None,
) -> Bool[np.ndarray, " n"]:
    """Whether no obstacle comes near each pose. For many calls on one scene build `Obstacles` once.

    Parameters
    ----------
    scene
        The obstacles.
    extent
        The vehicle: an `Extent`, a shape at rest, (3,) its size, or (2, 3) its bounds in the vehicle frame.
    world_from_vehicle
        (n, 4, 4) rigid poses; rows with nan are not clear.
    clearance
        Metres to keep to each side and above. At corners up to the square root of 3 times as much is kept.
    solid
        (k,) which instances count; by default all.
    """
    return Obstacles(scene, solid=solid).clear(extent, world_from_vehicle, clearance)


def clear_of_vehicles(
    extent: Extent | VehicleShape | ArrayLike,
    world_from_vehicle: ArrayLike,
    other: Extent | VehicleShape | ArrayLike,
    world_from_other: ArrayLike,
    clearance: float = 0.0,
) -> Bool[np.ndarray, " n"]:
    """Whether each pose keeps clear of another vehicle, or of several of one kind.

    Parameters
    ----------
    extent, other
        The vehicles: an `Extent`, a shape at rest, (3,) a size, or (2, 3) bounds in the vehicle frame.
    world_from_vehicle
        (n, 4, 4) rigid poses; rows with nan are not clear.
    world_from_other
        (m, 4, 4) poses to keep clear of, the same for all rows, or (n, m, 4, 4), each row's own; m = 0 is legal.
    clearance
        Metres to keep to each side and above.
    """
    mine, theirs = _extent_of(extent), _extent_of(other)
    poses = checked(world_from_vehicle, "world_from_vehicle", ("n", 4, 4), finite=False)
    others = checked(world_from_other, "world_from_other", ("...", "m", 4, 4))
    if others.shape[:-3] not in ((), (len(poses),)):
        raise ValueError(
            f"world_from_other: expected shape (m, 4, 4) or ({len(poses)}, m, 4, 4), got {np.shape(world_from_other)}"
        )
    known = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    clear = np.zeros(len(poses), dtype=bool)
    m, b, c = others.shape[-3], len(mine.half), len(theirs.half)
    others = np.broadcast_to(others, (len(poses), m, 4, 4))
    block = max(1, PAIRS // max(m * b * c, 1))
    for i in range(0, len(known), block):
        rows = known[i : i + block]
        half, world_from_mine = _grown(mine, poses[rows], clearance)
        world_from_theirs = compose(others[rows][:, :, None], theirs.vehicle_from_box)
        # Axes: row, other, box of mine, box of theirs.
        shape = (len(rows), m, b, c)
        mine_from_world = invert_rigid(world_from_mine.reshape(len(rows), 1, b, 1, 4, 4))
        touch = boxes_touch(
            np.broadcast_to(half.reshape(len(rows), 1, b, 1, 3), (*shape, 3)).reshape(-1, 3),
            np.broadcast_to(theirs.half, (*shape, 3)).reshape(-1, 3),
            compose(mine_from_world, world_from_theirs[:, :, None]).reshape(-1, 4, 4),
        )
        clear[rows] = ~touch.reshape(len(rows), -1).any(axis=1)
    return clear


def _extent_of(extent: Extent | VehicleShape | ArrayLike) -> Extent:
    if isinstance(extent, Extent):
        return extent
    if isinstance(extent, VehicleShape):
        return extent_of(extent)
    given = np.asarray(extent)
    if given.shape == (3,):
        size = checked(given, "extent", (3,))
        return _boxed(np.array([[[-size[0] / 2, -size[1] / 2, 0.0], [size[0] / 2, size[1] / 2, size[2]]]]), None)
    return _boxed(checked(given, "extent", (2, 3))[None], None)


def _boxed(bounds: Float[np.ndarray, "b 2 3"], vehicle_from_part: Float[np.ndarray, "b 4 4"] | None) -> Extent:
    """Boxes aligned with the frames of their parts, by default the vehicle's."""
    if (bounds[:, 0] > bounds[:, 1]).any():
        raise ValueError(f"extent: expected the lowest corner first and no size below 0, got {bounds.tolist()}")
    part_from_box = rigid(np.eye(3), bounds.mean(axis=1))
    poses = part_from_box if vehicle_from_part is None else compose(vehicle_from_part, part_from_box)
    return Extent((bounds[:, 1] - bounds[:, 0]) / 2, poses)


def _grown(
    extent: Extent, world_from_vehicle: Float[np.ndarray, "n 4 4"], clearance: float
) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, "q 4 4"]]:
    """Every box of every pose, larger by the clearance to the sides and upwards."""
    if not clearance >= 0:
        raise ValueError(f"clearance: expected metres of 0 or more, got {clearance}")
    half = extent.half + clearance * np.array([1.0, 1.0, 0.5])
    raised = rigid(np.eye(3), [0.0, 0.0, clearance / 2])
    poses = compose(world_from_vehicle[:, None], compose(extent.vehicle_from_box, raised))
    return np.tile(half, (len(world_from_vehicle), 1)), poses.reshape(-1, 4, 4)
