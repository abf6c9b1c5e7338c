import math

import numpy as np
import pytest

from hulldown.annotate.boxes import VehicleBoxes
from hulldown.annotate.silhouettes import whole_and_visible_masks
from hulldown.annotate.visibility import measure_visibility
from hulldown.benchmarks.visibility import error_bound
from hulldown.camera.cameras import NEAR_M, Cameras
from hulldown.camera.framing import pan_center_to_pixel as aimed_off
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.geometry.hulls import extreme_point_indices
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import rigid_matrix, rotation_z
from hulldown.scene.ground import Plane
from hulldown.scene.instances import InstancedScene
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster, bounding_points
from hulldown.scene.ray_caster import RayCaster
from hulldown.tests.builders.planning_assets import vehicle
from hulldown.tests.builders.shapes import box, vehicle_of

VGA = Intrinsics(640, 480, math.radians(50))
TANK = VehicleCaster(vehicle("t72"))
HERE = np.eye(4)[None]
CRATE = PosedVehicle(VehicleCaster(vehicle_of(box([-3, -1.5, 0], [3, 1.5, 2]))), HERE, {})
# From +x, towards the crate's front of 3 m x 2 m.
FRONT = Cameras(VGA, camera_pose([0, 0, 1.0], 30.0, 0.0, 0.0)[None])


def wall(y: tuple[float, float], z: tuple[float, float], x: float = 10.0) -> Mesh:
    return Mesh(
        np.array([[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]]), np.array([[0, 1, 2], [0, 2, 3]])
    )


def scene_of(*meshes: Mesh) -> InstancedScene:
    return InstancedScene(meshes, np.arange(len(meshes)), np.tile(np.eye(4), (len(meshes), 1, 1)))


def test_objects_behind_the_target_or_the_camera_hide_nothing() -> None:
    everywhere = ((-50.0, 50.0), (-50.0, 50.0))
    scene = scene_of(wall(*everywhere, x=-3.1), wall(*everywhere, x=30.1), wall(*everywhere, x=30 - NEAR_M / 2))
    assert measure_visibility([CRATE], FRONT, world=Scene(obstacles=scene)).fraction[0] == 1


def test_hidden_shares_are_counted_by_the_first_occluder_ground_obstacles_or_vehicles() -> None:
    # Parallel view from afar: the bottom fifth is behind a ridge, the left third of the rest behind a wall, ...
    lens = Intrinsics(640, 480, math.radians(0.5))
    far = Cameras(lens, camera_pose([0, 0, 1.0], 2000.0, 0.0, 0.0)[None])
    ridge = RayCaster(wall((-50, 50), (-50, 0.4)))
    side = scene_of(wall((-50, -0.5), (-50, 50)))
    # ... and its right third behind another crate.
    other = PosedVehicle(CRATE.caster, rigid_matrix(np.eye(3), [10.0, 2.0, 0])[None], {})
    worlds = [Scene(ridge, side, [other]), Scene(ridge), Scene(obstacles=side), Scene(vehicles=[other])]
    views = [measure_visibility([CRATE], far, world=world, rays=10_000) for world in worlds]
    # Perspective at 2 km moves these edges by less than 1 %.
    np.testing.assert_allclose([seen.fraction[0] for seen in views], [0.8 / 3, 0.8, 2 / 3, 2 / 3], atol=0.006)
    for seen in views:
        assert seen.area[0] == pytest.approx(6.0 * (lens.f_px / 1997) ** 2, rel=0.01)


SCENES = {
    "half hidden": wall((-50, 0.3), (-50, 50)),
    "hull down": wall((-50, 50), (-50, 1.1)),
    "a pole": wall((-0.3, 0.1), (-50, 50)),
    "a corner": wall((-0.2, 50), (1.0, 50)),
}


BARREL = Intrinsics.calibrated(960, 720, (720.0, 700.0, 456.0, 378.0), (-0.3, 0.1, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(("lens", "turned"), [(VGA.with_size(960, 720), {"turret": 1.0, "gun": 0.3}), (BARREL, {})])
def test_visibility_is_the_share_of_pixels_that_show_the_vehicle(name: str, lens: Intrinsics, turned: dict) -> None:
    camera = aimed_off(Cameras(lens, camera_pose([0, 0, 1.0], 16.0, 0.0, 0.02)), [700.0, 560.0])
    world = Scene(RayCaster(SCENES[name]))
    target = PosedVehicle(TANK, rigid_matrix(rotation_z(0.6), np.zeros(3))[None], turned)
    box = VehicleBoxes(TANK.shape).box(target.world_from_vehicle[0], camera, turned)
    whole, left = (mask.sum() for mask in whole_and_visible_masks(target, camera, xywh=box, world=world))
    seen = measure_visibility([target], camera.with_poses(camera.world_from_camera[None]), world=world, rays=20_000)
    assert 0.1 < left / whole < 0.95
    assert seen.fraction[0] == pytest.approx(left / whole, abs=0.005)
    assert seen.area[0] == pytest.approx(whole, rel=0.01)


def test_the_stated_error_holds_and_is_reached_with_dust() -> None:
    # A wall of holes far smaller than the cells: hits are random, the worst case for the bound.
    rng = np.random.default_rng(0)
    grid = np.argwhere(rng.random((120, 160)) < 0.5) * 0.025
    squares = np.array([[10, 0, 0], [10, 0.025, 0], [10, 0.025, 0.025], [10, 0, 0.025]])
    vertices = (squares[None] + np.insert(grid, 0, 0, axis=1)[:, None] + [0, -1.5, -0.5]).reshape(-1, 3)
    quads = np.arange(len(vertices)).reshape(-1, 4)
    dust = RayCaster(Mesh(vertices, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])))
    truth = measure_visibility([CRATE], FRONT, world=Scene(dust), rays=100_000).fraction[0]
    views = [measure_visibility([CRATE], FRONT, world=Scene(dust), rays=64, seed=s) for s in range(250)]
    off = np.array([v.fraction[0] for v in views]) - truth
    hits = np.mean([v.hits[0] for v in views])
    assert off.std() == pytest.approx(math.sqrt(truth * (1 - truth) / hits), rel=0.15)
    for confidence in (0.5, 0.8, 0.95):
        bound = np.array([error_bound(v.hits, confidence=confidence)[0] for v in views])
        assert (np.abs(off) <= bound).mean() >= confidence
    # Unbiased, within three standard errors of the mean.
    assert abs(off.mean()) < 3 * off.std() / math.sqrt(250)


def test_straight_edges_are_several_times_better_than_the_bound() -> None:
    options = {"world": Scene(RayCaster(SCENES["a corner"]))}
    tank = [PosedVehicle(TANK, HERE, {})]
    truth = measure_visibility(tank, FRONT, rays=100_000, **options).fraction[0]
    off = [measure_visibility(tank, FRONT, rays=256, seed=s, **options).fraction[0] - truth for s in range(60)]
    assert np.std(off) < 0.5 * 0.5 / math.sqrt(256)


def test_error_bounds() -> None:
    np.testing.assert_array_equal(error_bound(np.array([0, 1])), [np.nan, 1.0])
    # By hand: L = ln 40, (L / 3 + sqrt(L^2 / 9 + 50 L)) / 100.
    assert error_bound(np.array([100]))[0] == pytest.approx(0.14866, abs=5e-6)
    assert (np.diff(error_bound(np.arange(1, 1000))) <= 0).all()


def test_targets_outside_the_frame_have_no_fraction() -> None:
    away = FRONT.world_from_camera.copy()
    away[:, :3, :3] = away[:, :3, :3] @ np.diag([1.0, -1, -1])  # turned around
    aside = camera_pose([0, 40.0, 1], 30.0, 0.0, 0.0)
    seen = measure_visibility([CRATE], Cameras(VGA, np.stack([away[0], aside])), world=Scene(Plane(0.0)))
    assert np.isnan(seen.fraction).all()
    assert np.isnan(error_bound(seen.hits)).all()
    assert seen.hits.tolist() == [0, 0]
    assert seen.area.tolist() == [0, 0]


def test_cameras_inside_the_vehicle_or_with_the_vehicle_across_the_near_plane() -> None:
    inside = camera_pose([0, 0, 1.0], 0.5, 0.3, 0.1)
    across = camera_pose([3.0, 0, 1.0], NEAR_M / 2, 0.0, 0.0)
    seen = measure_visibility([CRATE], Cameras(VGA, np.stack([inside, across])))
    np.testing.assert_array_equal(seen.fraction, [1, 1])
    # From inside, the vehicle fills the frame.
    assert seen.hits.tolist() == [256, 256]


@pytest.mark.parametrize("flat", [False, True])
def test_few_points_stand_for_many(flat: bool) -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(3000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    ball *= [3.0, 1.0, 0.0 if flat else 0.01]
    hull = ball[extreme_point_indices(ball)]
    around = bounding_points(hull)
    assert len(around) <= (len(ball) if flat else 100)
    along = rng.normal(size=(500, 3))
    assert ((around @ along.T).max(axis=0) >= (ball @ along.T).max(axis=0)).all()


def test_results_do_not_depend_on_other_rows() -> None:
    n = 1500  # in two blocks
    rng = np.random.default_rng(0)
    poses = camera_pose([0, 0, 1], rng.uniform(5, 60, n), rng.uniform(0, 6, n), rng.uniform(0, 1.5, n))
    cameras = Cameras(VGA, poses)
    vehicles = rigid_matrix(rotation_z(rng.uniform(0, 6, n)), np.zeros(3))
    scene = scene_of(box([8, -4, 0], [9, 1, 3]), box([-9, -4, 0], [-8, 4, 1]))
    options = {"world": Scene(Plane(0.3), scene)}
    turned = [{"turret": angle} for angle in rng.uniform(-3, 3, n)]
    many = measure_visibility([PosedVehicle(TANK, vehicles, turned)], cameras, **options)
    for i in (0, 1, 300, 1499):
        target = PosedVehicle(TANK, vehicles[i : i + 1], turned[i])
        one = measure_visibility([target], cameras.take(slice(i, i + 1)), **options)
        assert one.fraction[0] == many.fraction[i]
        assert one.hits[0] == many.hits[i]
    assert 0.2 < many.fraction.mean() < 0.98


@pytest.mark.parametrize(("fov_deg", "distance"), [(0.1, 30.0), (179, 30.0), (50, 3000.0), (50, 300_000.0)])
def test_extreme_lenses_and_targets_smaller_than_a_pixel(fov_deg: float, distance: float) -> None:
    lens, half = Intrinsics(640, 480, math.radians(fov_deg)), scene_of(wall((-50, 0), (-50, 50)))
    camera = Cameras(lens, camera_pose([0, 0, 1.0], distance, 0.0, 0.0)[None])
    seen = measure_visibility([CRATE], camera, world=Scene(obstacles=half))
    assert seen.fraction[0] == pytest.approx(0.5, abs=0.05)
    assert seen.hits[0] > 200
