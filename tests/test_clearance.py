import math

import numpy as np
import pytest

from hulldown.camera.clearance import CameraRoom
from hulldown.camera.target import PosedVehicle, VehicleTarget
from hulldown.geometry.instances import InstancedScene
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.overlap import Obstacles
from hulldown.geometry.transforms import rigid, rotation_z
from hulldown.placement.rejection import Rejection
from hulldown.placement.terrain import Terrain
from hulldown.tests.shapes import box, vehicle_of

HOUSE = box([-5, -5, 0], [5, 5, 6])
CRATE = VehicleTarget(vehicle_of(box([-3, -1.5, 0], [3, 1.5, 2])))
NOTHING = Obstacles(InstancedScene([], [], np.zeros((0, 4, 4))))
# A house whose near wall is at x = 15.
STREET = Obstacles(InstancedScene([HOUSE], [0], rigid(np.eye(3), [20.0, 0, 0])[None]))


def judge(room: CameraRoom, *position: float, **limits: object) -> Rejection:
    return Rejection(int(room.rejections([list(position)], **limits)[0]))


@pytest.mark.parametrize(
    ("z", "expected"),
    [
        (3.4, Rejection.CAMERA_LOW),
        (3.6, Rejection.NONE),
        (2.9, Rejection.CAMERA_LOW),
        (-100.0, Rejection.CAMERA_LOW),
        (1e6, Rejection.NONE),
    ],
)
def test_cameras_stay_above_the_ground(z: float, expected: Rejection) -> None:
    assert judge(CameraRoom(Terrain(3.0), NOTHING), 0.0, 0.0, z, ground_clearance=0.5) == expected


def test_cameras_off_the_ground_and_low_cameras_have_different_reasons() -> None:
    ground = Terrain(Mesh(np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0]]), np.array([[0, 1, 2]])))
    room = CameraRoom(ground, NOTHING)
    assert judge(room, 50.0, 0.0, 5.0) == Rejection.CAMERA_OFF_GROUND
    assert judge(room, 1.0, 1.0, 5.0) == Rejection.NONE


@pytest.mark.parametrize("name", ["obstacle_clearance", "vehicle_clearance"])
@pytest.mark.parametrize("meters", [-0.1, math.nan])
def test_an_invalid_clearance_is_refused(name: str, meters: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected meters of 0 or more, got {meters}"):
        judge(CameraRoom(Terrain(0.0), STREET), 20.0, 0.0, 3.0, **{name: meters})


def test_no_surface_is_closer_than_the_clearance() -> None:
    room, rng = CameraRoom(Terrain(0.0), STREET), np.random.default_rng(0)
    place = rng.uniform([10, -8, 0.1], [30, 8, 9], (3000, 3))
    free = room.rejections(place, obstacle_clearance=1.0) == Rejection.NONE
    beyond = np.abs(place - [20, 0, 3]) - [5, 5, 3]
    distance = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    assert (distance[free] > 1.0).all()
    assert free[distance > math.sqrt(3)].all()


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        ((0.0, 0.0, 1.0), Rejection.CAMERA_VEHICLE),
        ((3.9, 0.0, 1.0), Rejection.CAMERA_VEHICLE),
        ((0.0, 3.0, 1.0), Rejection.NONE),
        ((4.1, 0.0, 1.0), Rejection.NONE),
    ],
)
def test_cameras_keep_clear_of_vehicles(position: tuple, expected: Rejection) -> None:
    at = rigid(rotation_z(1.0), [100.0, 200, 0])
    place = at[:3, :3] @ position + at[:3, 3]
    vehicle = PosedVehicle(CRATE, at[None], {})
    room = CameraRoom(Terrain(0.0), NOTHING)
    assert judge(room, *place, vehicles=[vehicle], vehicle_clearance=1.0) == expected
