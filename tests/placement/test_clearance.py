"""Clearance of cameras from ground, obstacles, and vehicles, and of boxes from obstacles."""

import math

import numpy as np
import pytest

from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.geometry.transforms import compose_affine, rigid_matrix, rotation_z
from hulldown.placement.clearance import CameraRoom
from hulldown.placement.terrain import Terrain
from hulldown.plan.rejection import Rejection
from hulldown.scene.instances import InstancedScene
from hulldown.scene.obstacles import Obstacles
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.tests.builders.shapes import box, vehicle_of

CAR = np.array([4.0, 2.0, 1.5])
HOUSE = box([-5, -5, 0], [5, 5, 6])
CRATE = VehicleCaster(vehicle_of(box([-3, -1.5, 0], [3, 1.5, 2])))
NOTHING = Obstacles(InstancedScene([], [], np.zeros((0, 4, 4))))
# A house whose near wall is at x = 15.
STREET = Obstacles(InstancedScene([HOUSE], [0], rigid_matrix(np.eye(3), [20.0, 0, 0])[None]))


def judge(room: CameraRoom, *position: float, **limits: object) -> Rejection:
    return Rejection(int(room.clearance_rejections([list(position)], **limits)[0]))


TRIANGLE = Terrain(Mesh(np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0]]), np.array([[0, 1, 2]])))


@pytest.mark.parametrize(
    ("ground", "position", "expected"),
    [
        *((Terrain(3.0), (0.0, 0.0, z), Rejection.CAMERA_LOW) for z in (3.4, 2.9, -100.0)),
        *((Terrain(3.0), (0.0, 0.0, z), Rejection.NONE) for z in (3.6, 1e6)),
        (TRIANGLE, (50.0, 0.0, 5.0), Rejection.CAMERA_OFF_GROUND),
        (TRIANGLE, (1.0, 1.0, 5.0), Rejection.NONE),
    ],
)
def test_cameras_stay_above_the_ground(ground: Terrain, position: tuple, expected: Rejection) -> None:
    assert judge(CameraRoom(ground, NOTHING), *position, ground_clearance=0.5) == expected


def test_cameras_may_be_above_roofs_without_ground_below() -> None:
    dome = box([-500, -500, -500], [500, 500, 500])
    pose = rigid_matrix(np.eye(3), [[20.0, 0, 0], [0, 0, 0]])
    obstacles = Obstacles(InstancedScene([HOUSE, dome], [0, 1], pose), extent=np.array([[0.0, 0.0], [9.0, 9.0]]))
    room = CameraRoom(TRIANGLE, obstacles)
    assert judge(room, 20.0, 0.0, 9.0) == Rejection.NONE
    assert judge(room, 20.0, 0.0, 6.5, obstacle_clearance=1.0) == Rejection.CAMERA_OBSTACLE
    assert judge(room, 40.0, 0.0, 9.0) == Rejection.CAMERA_OFF_GROUND  # the dome is no support


def test_no_surface_is_closer_than_the_clearance() -> None:
    room, rng = CameraRoom(Terrain(0.0), STREET), np.random.default_rng(0)
    place = rng.uniform([10, -8, 0.1], [30, 8, 9], (3000, 3))
    free = room.clearance_rejections(place, obstacle_clearance=1.0) == Rejection.NONE
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
    at = rigid_matrix(rotation_z(1.0), [100.0, 200, 0])
    place = at[:3, :3] @ position + at[:3, 3]
    vehicle = PosedVehicle(CRATE, at[None], {})
    room = CameraRoom(Terrain(0.0), NOTHING)
    assert judge(room, *place, vehicles=[vehicle], obstacle_clearance=1.0) == expected


def pose(x, y, z=0.0, yaw=0.0):
    return rigid_matrix(rotation_z(yaw), [x, y, z])


def clear_of_obstacles(scene, size, poses, clearance=0.0, *, solid=None):
    """Whether boxes at the origins of these poses, grown to the sides and upwards, are clear."""
    half = np.asarray(size) / 2 + clearance * np.array([1.0, 1.0, 0.5])
    boxes = compose_affine(np.array(poses), rigid_matrix(np.eye(3), [0, 0, half[2]]))
    return ~Obstacles(scene, solid=solid).blocked_box_mask(np.tile(half, (len(boxes), 1)), boxes)


BEAM = InstancedScene([box([-9, -0.1, 0], [9, 0.1, 0.2])], [0], [np.eye(4)])
BELOW_IT = [pose(0, 0, z) for z in (0.22, -1.45, -1.55, -1.75)]
# The arch's bounds contain the vehicle, its stone doesn't.
STONE = merge_meshes_with_sources([box([-3, 3, 0], [3, 4, 5]), box([-3, -4, 0], [3, -3, 5]), box([-3, -4, 4], [3, 4, 5])])[0]
ARCH = InstancedScene([STONE], [0], [pose(50, 0, yaw=0.3)])
UNDER_IT = [pose(50, 0, yaw=0.3), pose(50, 0, yaw=0.3 + math.pi / 2), pose(50, 0, 3.0, yaw=0.3)]
HALL = InstancedScene([box([-9, -9, -1], [9, 9, 9])], [0], [pose(100, 0, yaw=1.0)])
FLAT, MIRRORED = np.diag([5.0, 0.0, 2.0, 1.0]), np.diag([-5.0, 0.2, 2.0, 1.0])
FLAT[:3, 3] = [-2.5, 30, 0]
COPIES = InstancedScene([box([0, 0, 0], [1, 1, 1])], [0, 0], [FLAT, MIRRORED])
AROUND_THEM = [pose(x, y) for x, y in ((0, 29.1), (0, 28.9), (-6.9, 0), (-7.1, 0), (2.1, 0), (-3, 1.1), (-3, 1.3))]


@pytest.mark.parametrize(
    ("scene", "size", "poses", "clearance", "expected"),
    [
        pytest.param(BEAM, CAR, BELOW_IT, 0.0, [1, 0, 1, 1], id="a beam"),
        pytest.param(BEAM, CAR, BELOW_IT, 0.1, [1, 0, 0, 1], id="clearance above a vehicle, not below"),
        pytest.param(ARCH, CAR, UNDER_IT, 0.5, [1, 1, 0], id="a vehicle fits under an arch"),
        pytest.param(ARCH, [9.0, 2.0, 1.5], UNDER_IT, 0.5, [1, 0, 0], id="a long one only along it"),
        pytest.param(HALL, CAR, [pose(100, 0), pose(100, 20)], 0.0, [0, 1], id="inside an obstacle"),
        pytest.param(COPIES, CAR, AROUND_THEM, 0.0, [0, 1, 0, 1, 1, 0, 1], id="mirrored, stretched, squashed copies"),
    ],
)
def test_vehicles_keep_clear_of_obstacles(scene, size, poses, clearance, expected):
    assert clear_of_obstacles(scene, size, poses, clearance).tolist() == list(map(bool, expected))


def test_obstacles_that_give_way_are_ignored():
    places = [pose(0, 0), pose(0, 20)]
    field = InstancedScene([box([-0.1, -0.1, 0], [0.1, 0.1, 0.3])], [0, 0], places)
    assert clear_of_obstacles(field, CAR, places).tolist() == [False, False]
    assert clear_of_obstacles(field, CAR, places, solid=np.array([False, True])).tolist() == [True, False]
