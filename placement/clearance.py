"""Clearance of cameras from ground, water, obstacles, and vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.camera.cameras import NEAR_M
from hulldown.geometry.transforms import invert_rigid, transform_points
from hulldown.placement.terrain import Terrain
from hulldown.scene.obstacles import Obstacles
from hulldown.scene.posed_vehicle import PosedVehicle


class CameraRejection(IntEnum):
    """What a camera is too close to; 0 is a free place. `plan.rejection` has the codes in plan files."""

    NONE = 0
    OFF_GROUND = 12
    LOW = 13
    OBSTACLE = 14
    VEHICLE = 15
    WATER = 23


@dataclass(frozen=True, eq=False, slots=True)
class CameraRoom:
    """Checks positions of cameras in one scenery."""

    terrain: Terrain
    obstacles: Obstacles  # everything solid but ground and vehicles. A camera may look out of grass.
    water: Terrain | None = None  # surfaces that a camera may not be below

    def clearance_rejections(
        self,
        position: ArrayLike,
        *,
        ground_clearance: float = 0.0,
        obstacle_clearance: float = 0.0,
        vehicles: Sequence[PosedVehicle] = (),
    ) -> UInt8[np.ndarray, " n"]:
        """Return a `CameraRejection` for each place: the first of ground, height, water, obstacles, and vehicles.

        `position`: world.
        `ground_clearance`: least height in meters above the topmost ground at that (x, y): under a bridge of ground is
        below it. Where there's no ground, a camera may be above an obstacle, such as a roof or a lawn. The same above
        the topmost water, and there at least twice the distance of the near plane, which then stays dry.
        `obstacle_clearance`: half the side in meters of the upright cube about the camera that no obstacle's surface
        may touch: no surface is nearer than this. A camera that an obstacle shuts in on all sides and above is inside
        it. Also the least distance to the bounding boxes of vehicles' parts; never inside one.
        """
        place = checked_array(position, "position", ("n", 3))
        if not obstacle_clearance >= 0.0:
            raise ValueError(f"obstacle_clearance: expected meters of 0 or more, got {obstacle_clearance}")
        n = len(place)
        rejection = np.zeros(n, dtype=np.uint8)
        for vehicle in vehicles:
            rejection[_vehicle_distance(vehicle, place) <= obstacle_clearance] = CameraRejection.VEHICLE
        cube = np.tile(np.eye(4), (n, 1, 1))
        cube[:, :3, 3] = place
        rejection[self.obstacles.blocked_box_mask(np.full((n, 3), float(obstacle_clearance)), cube)] = CameraRejection.OBSTACLE
        if self.water is not None:
            water = self.water.top_hits(place[:, :2])
            with np.errstate(invalid="ignore"):
                wet = place[:, 2] - water.z < max(ground_clearance, 2.0 * NEAR_M)
            rejection[wet] = CameraRejection.WATER
        ground = self.terrain.top_hits(place[:, :2])
        with np.errstate(invalid="ignore"):
            rejection[place[:, 2] - ground.z < ground_clearance] = CameraRejection.LOW
        off = np.flatnonzero(~ground.hit)
        rejection[off[~self.obstacles.above_obstacle_mask(place[off])]] = CameraRejection.OFF_GROUND
        return rejection


def _vehicle_distance(vehicle: PosedVehicle, place: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the distance to the nearest bounding box of a part; 0 inside."""
    world = np.tile(np.eye(4), (len(place), 1, 1))
    distance = np.full(len(place), np.inf)
    row, parts = vehicle.cameras_and_posed_parts(world)
    for part, world_from_part in parts:
        local = transform_points(invert_rigid(world_from_part), place[row, None])[:, 0]
        low, high = part.hull.min(axis=0), part.hull.max(axis=0)
        beyond = np.maximum(np.maximum(low - local, local - high), 0.0)
        np.minimum.at(distance, row, np.linalg.norm(beyond, axis=1))
    return distance
