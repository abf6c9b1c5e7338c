import math

import numpy as np
import pytest

from assets.vehicle import VehicleShape
from geometry.instances import InstancedScene
from geometry.meshes import Mesh
from geometry.transforms import rigid, rotation_about, rotation_z
from placement.clearance import Obstacles, clear_of_obstacles, clear_of_vehicles, extent_of

SIZE = np.array([4.0, 2.0, 1.5])
_UNIT = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
_SIDES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 3, 7], [1, 7, 5]]
)  # fmt: skip


def block(low, high):
    return Mesh(np.asarray(low) + _UNIT * (np.asarray(high) - np.asarray(low)), _SIDES, "block")


def pose(x, y, z=0.0, yaw=0.0):
    return rigid(rotation_z(yaw), [x, y, z])


def post(height=3.0):
    """A thin post that stands at the origin."""
    return InstancedScene([block([-0.1, -0.1, 0], [0.1, 0.1, height])], [0], [np.eye(4)])


def test_clearance_is_kept_above_and_not_below():
    beam = InstancedScene([block([-9, -0.1, 0], [9, 0.1, 0.2])], [0], [np.eye(4)])
    heights = [0.22, -1.45, -1.55, -1.75]
    assert clear_of_obstacles(beam, SIZE, [pose(0, 0, z) for z in heights], 0.0).tolist() == [True, False, True, True]
    assert clear_of_obstacles(beam, SIZE, [pose(0, 0, z) for z in heights], 0.1).tolist() == [True, False, False, True]


def test_a_turned_vehicle_passes_where_its_upright_box_would_not():
    diagonal = pose(1.2, -1.2, yaw=math.pi / 4)
    assert clear_of_obstacles(post(), SIZE, [diagonal, pose(1.2, -0.8)]).tolist() == [True, False]


def test_between_the_bounds_and_the_triangles_lies_room():
    # An arch: its bounds hold the vehicle, its stone does not.
    arch = Mesh(
        np.concatenate([block([-3, 3, 0], [3, 4, 5]).vertices, block([-3, -4, 0], [3, -3, 5]).vertices,
                        block([-3, -4, 4], [3, 4, 5]).vertices]),
        np.concatenate([_SIDES, _SIDES + 8, _SIDES + 16]),
    )  # fmt: skip
    scene = InstancedScene([arch], [0], [pose(50, 0, yaw=0.3)])
    poses = [pose(50, 0, yaw=0.3), pose(50, 0, yaw=0.3 + math.pi / 2), pose(50, 0, 3.0, yaw=0.3)]
    assert clear_of_obstacles(scene, SIZE, poses, 0.5).tolist() == [True, True, False]
    assert clear_of_obstacles(scene, [9.0, 2.0, 1.5], poses, 0.5).tolist() == [True, False, False]


def test_a_vehicle_wholly_inside_an_obstacle_is_not_clear():
    hall = InstancedScene([block([-9, -9, -1], [9, 9, 9])], [0], [pose(100, 0, yaw=1.0)])
    assert clear_of_obstacles(hall, SIZE, [pose(100, 0), pose(100, 20)]).tolist() == [False, True]


def test_what_gives_way_stands_in_nobodys_way():
    mesh = block([-0.1, -0.1, 0], [0.1, 0.1, 0.3])
    field = InstancedScene([mesh], [0, 0], [pose(0, 0), pose(0, 20)])
    places = [pose(0, 0), pose(0, 20)]
    assert clear_of_obstacles(field, SIZE, places).tolist() == [False, False]
    assert clear_of_obstacles(field, SIZE, places, solid=np.array([False, True])).tolist() == [True, False]


def test_mirrored_stretched_and_squashed_copies_are_held_where_they_are():
    mesh = block([0, 0, 0], [1, 1, 1])
    flat = np.diag([5.0, 0.0, 2.0, 1.0])
    flat[:3, 3] = [-2.5, 30, 0]
    mirrored = np.diag([-5.0, 0.2, 2.0, 1.0])
    scene = InstancedScene([mesh], [0, 0], [flat, mirrored])
    poses = [pose(0, 29.1), pose(0, 28.9), pose(-6.9, 0), pose(-7.1, 0), pose(2.1, 0), pose(-3, 1.1), pose(-3, 1.3)]
    assert clear_of_obstacles(scene, SIZE, poses).tolist() == [False, True, False, True, True, False, True]


def test_rows_without_a_pose_are_not_clear_and_no_rows_and_no_obstacles_are_legal():
    nowhere = np.full((4, 4), np.nan)
    empty = InstancedScene([], [], [])
    assert clear_of_obstacles(post(), SIZE, [nowhere, pose(9, 9)]).tolist() == [False, True]
    assert clear_of_obstacles(empty, SIZE, [nowhere, pose(0, 0)]).tolist() == [False, True]
    assert clear_of_obstacles(post(), SIZE, np.zeros((0, 4, 4))).shape == (0,)
    assert clear_of_vehicles(SIZE, [nowhere, pose(0, 0)], SIZE, np.zeros((0, 4, 4))).tolist() == [False, True]


@pytest.mark.parametrize(("gap", "clearance", "clear"), [(0.1, 0.0, True), (-0.1, 0.0, False), (0.4, 0.5, False)])
def test_vehicles_keep_their_clearance(gap, clearance, clear):
    others = [pose(4.0 + gap, 0.3), pose(0.2, -2.0 - gap)]
    for other in others:
        assert clear_of_vehicles(SIZE, [np.eye(4)], SIZE, [other], clearance).tolist() == [clear]
    assert clear_of_vehicles(SIZE, [np.eye(4)], SIZE, others, clearance).tolist() == [clear]


def test_a_turned_barrel_reaches_where_it_points():
    hull, barrel = block([-2, -1, 0], [2, 1, 1.5]), block([0, -0.1, 1.2], [6, 0.1, 1.4])
    shape = VehicleShape(
        name="tank",
        mesh=Mesh(np.concatenate([hull.vertices, barrel.vertices]), np.concatenate([_SIDES, _SIDES + 8])),
        vertex_part=np.repeat([0, 1], 8),
        part_names=("hull", "turret"),
        part_parent=np.array([-1, 0]),
        part_pivot=np.zeros((2, 3)),
        part_axis=np.tile([0.0, 0.0, 1.0], (2, 1)),
        part_limits=np.array([[0.0, 0.0], [-np.pi, np.pi]]),
        vehicle_from_file=np.eye(4),
    )
    poses = [pose(-5, 0), pose(0, -5), pose(-5, -2), pose(-4.4, -4.4)]
    assert clear_of_obstacles(post(), shape, poses).tolist() == [False, True, True, True]
    left = extent_of(shape, {"turret": math.pi / 2})
    assert clear_of_obstacles(post(), left, poses).tolist() == [True, False, True, True]
    assert Obstacles(post()).clear(extent_of(shape, {"turret": math.pi / 4}), poses).tolist() == [
        True,
        True,
        True,
        True,
    ]
    nearer = [pose(-3, -3)]
    assert Obstacles(post()).clear(extent_of(shape, {"turret": math.pi / 4}), nearer).tolist() == [False]


@pytest.mark.parametrize(
    ("extent", "clearance", "message"),
    [
        ([1.0, 2.0], 0.0, r"extent: expected shape \(2, 3\), got \(2,\)"),
        ([1.0, -2.0, 1.0], 0.0, "extent: expected the lowest corner first and no size below 0"),
        (SIZE, -1.0, "clearance: expected metres of 0 or more, got -1.0"),
    ],
)
def test_a_wrong_call_names_the_argument(extent, clearance, message):
    with pytest.raises(ValueError, match=message):
        clear_of_obstacles(post(), extent, [np.eye(4)], clearance)
    with pytest.raises(ValueError, match=message):
        clear_of_vehicles(extent, [np.eye(4)], SIZE, [np.eye(4)], clearance)


def test_tilted_boxes_are_apart_exactly_if_some_sampled_point_is_not_shared():
    rng = np.random.default_rng(7)
    poses = rigid(
        rotation_about(_unit(rng.normal(size=(400, 3))), rng.uniform(-3, 3, 400)), rng.uniform(-4, 4, (400, 3))
    )
    clear = clear_of_vehicles(SIZE, poses, [3.0, 1.0, 2.0], [np.eye(4)])
    # Points of the second box, seen from the first: one inside proves contact, none nearly disproves it.
    points = np.stack(np.meshgrid(*(np.linspace(a, b, 21) for a, b in ((-1.5, 1.5), (-0.5, 0.5), (0, 2)))), -1)
    seen = np.einsum("nji,npj->npi", poses[:, :3, :3], points.reshape(1, -1, 3) - poses[:, None, :3, 3])
    shared = ((seen >= [-2, -1, 0]) & (seen <= [2, 1, 1.5])).all(axis=2).any(axis=1)
    assert 0.1 < shared.mean() < 0.9
    assert not (clear & shared).any()
    assert (~clear & ~shared).mean() < 0.02


def _unit(v):
    return v / np.linalg.norm(v, axis=1, keepdims=True)
