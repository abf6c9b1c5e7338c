"""Clearance of cameras from ground, obstacles, and vehicles, and of boxes from obstacles."""

import math

import numpy as np
import pytest

from hulldown.camera.clearance import CameraRoom
from hulldown.camera.target import PosedVehicle, VehicleTarget
from hulldown.geometry.instances import InstancedScene
from hulldown.geometry.meshes import Mesh, merge
from hulldown.geometry.overlap import Obstacles, boxes_touch
from hulldown.geometry.transforms import compose, invert_rigid, rigid, rotation_z
from hulldown.placement.rejection import Rejection
from hulldown.placement.terrain import Terrain
from hulldown.tests.shapes import box, random_rotations, vehicle_of

CAR = np.array([4.0, 2.0, 1.5])
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


def pose(x, y, z=0.0, yaw=0.0):
    return rigid(rotation_z(yaw), [x, y, z])


def clear_of_obstacles(scene, size, poses, clearance=0.0, *, solid=None):
    """Whether boxes at the origins of these poses, grown to the sides and upwards, are clear."""
    half = np.asarray(size) / 2 + clearance * np.array([1.0, 1.0, 0.5])
    boxes = compose(np.array(poses), rigid(np.eye(3), [0, 0, half[2]]))
    return ~Obstacles(scene, solid=solid).touched(np.tile(half, (len(boxes), 1)), boxes)


def test_clearance_is_kept_above_but_not_below():
    beam = InstancedScene([box([-9, -0.1, 0], [9, 0.1, 0.2])], [0], [np.eye(4)])
    heights = [0.22, -1.45, -1.55, -1.75]
    assert clear_of_obstacles(beam, CAR, [pose(0, 0, z) for z in heights], 0.0).tolist() == [True, False, True, True]
    assert clear_of_obstacles(beam, CAR, [pose(0, 0, z) for z in heights], 0.1).tolist() == [True, False, False, True]


def test_a_vehicle_fits_under_an_arch():
    # The arch's bounds contain the vehicle, its stone doesn't.
    arch, _ = merge([box([-3, 3, 0], [3, 4, 5]), box([-3, -4, 0], [3, -3, 5]), box([-3, -4, 4], [3, 4, 5])])
    scene = InstancedScene([arch], [0], [pose(50, 0, yaw=0.3)])
    poses = [pose(50, 0, yaw=0.3), pose(50, 0, yaw=0.3 + math.pi / 2), pose(50, 0, 3.0, yaw=0.3)]
    assert clear_of_obstacles(scene, CAR, poses, 0.5).tolist() == [True, True, False]
    assert clear_of_obstacles(scene, [9.0, 2.0, 1.5], poses, 0.5).tolist() == [True, False, False]


def test_a_vehicle_inside_an_obstacle_is_not_clear():
    hall = InstancedScene([box([-9, -9, -1], [9, 9, 9])], [0], [pose(100, 0, yaw=1.0)])
    assert clear_of_obstacles(hall, CAR, [pose(100, 0), pose(100, 20)]).tolist() == [False, True]


def test_obstacles_that_give_way_are_ignored():
    mesh = box([-0.1, -0.1, 0], [0.1, 0.1, 0.3])
    field = InstancedScene([mesh], [0, 0], [pose(0, 0), pose(0, 20)])
    places = [pose(0, 0), pose(0, 20)]
    assert clear_of_obstacles(field, CAR, places).tolist() == [False, False]
    assert clear_of_obstacles(field, CAR, places, solid=np.array([False, True])).tolist() == [True, False]


def test_mirrored_stretched_and_squashed_copies_are_in_the_right_place():
    mesh = box([0, 0, 0], [1, 1, 1])
    flat = np.diag([5.0, 0.0, 2.0, 1.0])
    flat[:3, 3] = [-2.5, 30, 0]
    mirrored = np.diag([-5.0, 0.2, 2.0, 1.0])
    scene = InstancedScene([mesh], [0, 0], [flat, mirrored])
    poses = [pose(0, 29.1), pose(0, 28.9), pose(-6.9, 0), pose(-7.1, 0), pose(2.1, 0), pose(-3, 1.1), pose(-3, 1.3)]
    assert clear_of_obstacles(scene, CAR, poses).tolist() == [False, True, False, True, True, False, True]


def test_tilted_boxes_are_apart_exactly_if_they_share_no_sampled_point():
    rng = np.random.default_rng(7)
    poses = rigid(random_rotations(rng, 400), rng.uniform(-4, 4, (400, 3)))
    first, second = (compose(at, rigid(np.eye(3), [0, 0, up])) for at, up in ((poses, 0.75), (np.eye(4), 1.0)))
    half = np.tile(np.array([3.0, 1.0, 2.0]) / 2, (400, 1))
    clear = ~boxes_touch(np.tile(CAR / 2, (400, 1)), half, compose(invert_rigid(first), second))
    # Points of the second box in the first one's frame: one inside proves contact, none almost disproves it.
    points = np.stack(np.meshgrid(*(np.linspace(a, b, 21) for a, b in ((-1.5, 1.5), (-0.5, 0.5), (0, 2)))), -1)
    seen = np.einsum("nji,npj->npi", poses[:, :3, :3], points.reshape(1, -1, 3) - poses[:, None, :3, 3])
    shared = ((seen >= [-2, -1, 0]) & (seen <= [2, 1, 1.5])).all(axis=2).any(axis=1)
    assert 0.1 < shared.mean() < 0.9
    assert not (clear & shared).any()
    assert (~clear & ~shared).mean() < 0.02
