"""A wrong call names its argument, what was expected, and what was given; a call with no rows has no results."""

import math

import numpy as np
import pytest

from hulldown.annotate.boxes import VehicleBoxes, surface_box
from hulldown.annotate.visibility import measure_visibility
from hulldown.base.arrays import checked_array, checked_whole_number
from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import turn_cameras_to_targets
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose, sample_elevations
from hulldown.camera.size import solve_distance
from hulldown.geometry.meshes import Mesh, first_equal_indices, merge_meshes_with_sources
from hulldown.geometry.transforms import invert_rigid, tilt_rotation, transform_points, yaw_and_up_rotation
from hulldown.placement.candidates import sample_candidates
from hulldown.placement.clearance import CameraRoom
from hulldown.placement.footprint import contact_footprint, vehicle_underside
from hulldown.placement.rest import fit_support_planes
from hulldown.placement.settle import REST_RULES, SettleRules, settle
from hulldown.placement.terrain import Terrain
from hulldown.scene.instances import InstancedScene
from hulldown.scene.obstacles import Obstacles
from hulldown.scene.posed_scene import NO_OBSTACLES, Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.scene.ray_caster import RayCaster
from hulldown.scene.rays import RayList
from hulldown.tests.builders.shapes import box, sheet, vehicle_of

ONE, DOWN = np.eye(4)[None], [0.0, 0.0, -1.0]
POINTS, FACES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 2.0]]), [[0, 1, 2], [0, 2, 3]]
FLOOR, CUBE = sheet((0, 0), (10, 10)), box((-1, -1, 0), (1, 1, 2), "cube")
VGA, THREE, NO_CAMERA = (Intrinsics(640, 480, fov_x) for fov_x in (1.0, np.ones(3), np.ones(0)))
AWAY = camera_pose([0, 0, 0], 50.0, 0.0, 0.0)[None]
CRATE = vehicle_of(CUBE)
SEEN = [PosedVehicle(VehicleCaster(CRATE), ONE, {})]
PINHOLE = (800.0, 800.0, 960.0, 540.0)


def rng():
    return np.random.default_rng(0)


def mesh(vertices=POINTS, faces=FACES):
    return Mesh(vertices, np.array(faces), "hill")


def cast(origins, directions, limit=1.0):
    return RayCaster(FLOOR).cast(origins, directions, max_distance=limit)


def tries(bounds=((0, 0, 0), (1, 1, 1)), n=1, margin=0.8):
    return sample_candidates(bounds, n, rng=rng(), margin=margin)


def settled(width=3.5, n=1, **options):
    xy = np.full((n, 2), 5.0)
    return settle(Terrain(FLOOR), [7.0, width, 2.5], xy, np.zeros(n), **options)


def solved(poses=AWAY, center=(0, 0, 0), pixels=10.0):
    return solve_distance(Cameras(VGA, poses), POINTS[None], center=center, pixels=pixels)


def framed(poses=AWAY, points=POINTS[None], **options):
    return turn_cameras_to_targets(Cameras(VGA, poses), points, rng=rng(), **options)


def clear(**options):
    return CameraRoom(Terrain(0.0), Obstacles(NO_OBSTACLES)).clearance_rejections([[0.0, 0.0, 3.0]], **options)


WRONG = [
    (lambda: checked_array([1.0, 2.0], "xy", ("n", 2)), r"xy: expected shape \(n, 2\), got \(2,\)"),
    (lambda: checked_array([[1.0, 2.0, 3.0]], "xy", ("n", "n")), r"xy: expected shape \(n, n\), got \(1, 3\)"),
    (lambda: checked_array([1.0], "xy", (3,)), r"xy: expected shape \(3,\), got \(1,\)"),
    (lambda: checked_array([[0, np.nan]], "xy", ("n", 2)), r"xy: expected finite numbers, got nan at index \(0, 1\)"),
    (lambda: checked_array([[0, 1], [-np.inf, 0]], "xy", ("n", 2)), r"xy: expected finite .*, got -inf at index \(1, 0\)"),
    (lambda: checked_array("here", "xy", ("n", 2)), r"xy: expected float64 array of shape \(n, 2\), got 'here'"),
    (lambda: checked_array([1.0, 2.0 + 1j], "xy", (2,)), r"xy: expected float64 array of shape \(2,\), got"),
    (lambda: checked_array([[1.5]], "xy", ("n", 1), dtype=np.int64), r"xy: expected int64 array of shape \(n, 1\)"),
    *(
        (lambda v=v: checked_whole_number(v, "n"), "n: expected a whole number, got")
        for v in (2.5, 2.0, "2", True, None, math.nan)
    ),
    (lambda: tilt_rotation([0.0, 0.0, -1.0]), "normal: expected a direction away from -z"),
    (lambda: yaw_and_up_rotation(0.0, [1.0, 0.0, 0.0]), "up: expected directions with z > 0"),
    (lambda: transform_points(np.eye(3), np.zeros((1, 3))), "b_from_a: expected shape"),
    (lambda: invert_rigid(np.full((4, 4), np.nan)), "b_from_a: expected finite numbers"),
    (lambda: mesh(POINTS[:, :2]), r"mesh 'hill': vertices: expected numbers of shape \(v, 3\), got float64 \(4, 2\)"),
    (lambda: mesh(np.array([["a"] * 3] * 4)), "mesh 'hill': vertices: expected numbers"),
    (lambda: mesh(faces=[[0, 1]]), r"mesh 'hill': faces: expected integers of shape \(f, 3\), got int64 \(1, 2\)"),
    (lambda: mesh(faces=np.zeros((1, 3))), r"mesh 'hill': faces: expected integers of shape \(f, 3\), got float64"),
    (lambda: mesh(faces=np.zeros((0, 3), int)), "mesh 'hill': expected at least one face, got an empty mesh"),
    (lambda: mesh(POINTS[:0]), r"mesh 'hill': face 0 is \[0, 1, 2\]; expected indices below 0"),
    (lambda: mesh(POINTS[:3]), r"mesh 'hill': face 1 is \[0, 2, 3\]; expected indices below 3"),
    (lambda: mesh(faces=[[-1, 0, 1]]), r"mesh 'hill': face 0 is \[-1, 0, 1\]"),
    (lambda: mesh(np.full((4, 3), np.nan)), r"mesh 'hill': vertex 0 is \[nan, nan, nan\]; expected finite"),
    (lambda: mesh(np.vstack([POINTS[:3], [0, 1, np.inf]])), r"mesh 'hill': vertex 3 is \[0\.0, 1\.0, inf\]"),
    (lambda: merge_meshes_with_sources([]), "meshes: expected at least one mesh"),
    (lambda: InstancedScene([CUBE], [1], ONE), "instance_mesh: expected indices below 1, got 1 to 1"),
    (lambda: InstancedScene([CUBE], [-1], ONE), "instance_mesh: expected indices below 1"),
    (lambda: InstancedScene([CUBE], [0, 0], ONE), r"instance_mesh: expected shape \(1,\), got \(2,\)"),
    (lambda: InstancedScene([CUBE], [0], 2 * ONE), r"world_from_instance: expected last rows \(0, 0, 0, 1\)"),
    (lambda: cast([[0, 0]], [DOWN]), r"origins: expected shape \(n, 3\), got \(1, 2\)"),
    (lambda: cast([[0, 0, np.nan]], [DOWN]), "origins: expected finite numbers"),
    (lambda: cast([[0, 0, 1]] * 2, [DOWN]), r"directions: expected shape \(2, 3\), got \(1, 3\)"),
    (lambda: cast([[0, 0, 1]] * 2, [DOWN, [0, 0, 0]]), "directions: expected lengths .*, got a zero at index 1"),
    (lambda: cast([[0, 0, 1]], [DOWN], [1.0, 2.0]), r"max_distance: expected a number or shape \(1,\), got .*\(2,\)"),
    (lambda: cast([[0, 0, 1]], [DOWN], np.nan), "max_distance: expected meters, got nan"),
    *(
        (lambda k=kind, high=high: k(sheet((0, 0), (high, high))), "mesh 'sheet': expected coordinates within 1e30 m")
        for kind in (RayCaster, Terrain)
        for high in (1e31, 1e300)
    ),
    (lambda: Terrain(FLOOR).top_hits([[0, 0, 0]]), r"xy: expected shape \(n, 2\), got \(1, 3\)"),
    (lambda: Terrain(FLOOR).top_hits([[0, 0], [np.nan, 0]]), r"xy: expected finite numbers, got nan at index \(1, 0\)"),
    (lambda: tries(n=-1), "n: expected a count of 0 or more, got -1"),
    (lambda: tries(margin=1.5), r"margin: expected a share in \(0, 1\], got 1.5"),
    (lambda: tries([[2, 0, 0], [1, 1, 1]]), "bounds: expected the lowest corner first"),
    (lambda: tries([[-np.inf, 0, 0], [1, 1, 1]]), "bounds: expected finite numbers"),
    (lambda: tries([0, 0, 0]), r"bounds: expected shape \(2, 2\)"),
    (lambda: contact_footprint(np.zeros((0, 3))), "vertices: expected at least one vertex"),
    (lambda: vehicle_underside(Mesh(POINTS[[0, 1, 1]], np.array([[0, 1, 2]]))), "mesh: expected a length and a width"),
    (lambda: SettleRules(rule="mean"), "rule: expected one of averaged, support, got 'mean'"),
    (lambda: SettleRules(n=1), "n: expected 2 to 9 rays a side, got 1"),
    (lambda: SettleRules(contact_n=-1), "contact_n: expected 0 or more points a side, got -1"),
    (lambda: SettleRules(max_slope=1.6), r"max_slope: expected radians in \[0, pi/2\), got 1.6"),
    (lambda: SettleRules(min_share=1.1), r"min_share: expected a share in \[0, 1\], got 1.1"),
    (lambda: SettleRules(min_share=math.nan), r"min_share: expected a share in \[0, 1\], got nan"),
    (lambda: SettleRules(max_gap=math.nan), "max_gap: expected meters of 0 or more, got nan"),
    (lambda: SettleRules(max_penetration=-0.1), "max_penetration: expected meters of 0 or more, got -0.1"),
    (lambda: settled(footprint=[[1, 1], [0, 2]]), "footprint: expected the lowest corner first"),
    (lambda: settled(0.0), r"size_xyz: expected lengths above 0, got \[7.0, 0.0, 2.5\]"),
    (lambda: camera_pose([0, 0, 0], 0.0, 0.0, 0.0), "distance: expected positive"),
    (lambda: camera_pose([0, 0, 0], math.nan, 0.0, 0.0), "distance: expected finite"),
    (lambda: camera_pose([0, 0, 0], 1.0, 0.0, 1.6), "elevation: expected radians .*, got 1.6"),
    (lambda: camera_pose([0, 0, 0], 1.0, 0.0, -45.0), "elevation: expected radians .*, got -45"),
    (lambda: sample_elevations(1, (0.5, 0.4), rng=rng()), "bounds: expected"),
    (lambda: Intrinsics(0, 10, 1.0), "width: expected"),
    *((lambda x=fov_x: Intrinsics(9, 9, x), "fov_x: expected radians") for fov_x in (0.0, math.pi, 60.0, math.nan)),
    (lambda: VGA.target_distance(0, 0.1), "size: expected positive numbers"),
    (lambda: VGA.target_distance(1, -1), "target_fraction: expected positive numbers"),
    (lambda: Intrinsics.calibrated(1920, 1080, PINHOLE, (-0.2, 0, 0, 0, 0)), r"distortion: .*folds at 1.29"),
    *(
        (lambda p=pose: Cameras(VGA, p), "world_from_camera: expected a rigid 4x4 transform")
        for pose in (np.diag([2.0, 2, 2, 1]), np.diag([1.0, 1, -1, 1]), np.eye(4) + 0.1 * np.eye(4, k=-3))
    ),
    (lambda: framed(spread=1.5), "spread: expected"),
    (lambda: framed(truncated=(0.5, 0.2)), "truncated: expected"),
    (lambda: framed(truncated=(-0.1, 0.2)), "truncated: expected"),
    (lambda: framed(points=np.zeros((3, 8, 3))), "points_world: expected 1 or 1 sets of points, got 3"),
    (lambda: solved(pixels=0.0), "pixels: expected"),
    (lambda: solved(center=[100.0, 0, 0]), "center: expected"),
    (lambda: measure_visibility(SEEN, Cameras(VGA, AWAY), rays=0), "rays: expected at least 1"),
    (
        lambda: measure_visibility([PosedVehicle(SEEN[0].caster, ONE.repeat(3, 0), {})], Cameras(VGA, AWAY)),
        "subjects: expected 1 or 1 poses, got 3",
    ),
    (lambda: PosedVehicle(SEEN[0].caster, ONE, [{}, {}]), "articulation: expected one or 1, got 2"),
    *(
        (lambda m=meters: clear(obstacle_clearance=m), f"obstacle_clearance: expected meters of 0 or more, got {meters}")
        for meters in (-0.1, math.nan)
    ),
    (lambda: VehicleBoxes(CRATE).boxes(ONE[0], Cameras(VGA, ONE)), "world_from_vehicle: expected shape"),
    (lambda: VehicleBoxes(CRATE).boxes(np.nan * ONE, Cameras(VGA, ONE)), "world_from_vehicle: expected finite numbers"),
    (lambda: VehicleBoxes(CRATE).boxes(ONE, Cameras(VGA, ONE.repeat(2, 0))), "cameras: expected 1, one for each"),
    (lambda: Cameras(THREE, ONE), "lenses: expected one, or one for each pose"),
    (lambda: VehicleBoxes(CRATE).boxes(ONE, Cameras(VGA, ONE), [{}, {}]), "articulations: expected 1, one for each"),
    (lambda: surface_box(POINTS, [[0, 1, 4]], Cameras(VGA, ONE[0])), "faces: expected indices below 4"),
]


@pytest.mark.parametrize(("call", "message"), WRONG)
def test_the_error_of_a_wrong_call_names_the_argument(call, message):
    with pytest.raises(ValueError, match=message):
        call()


RAYS, GRID, LINE = (
    RayList(np.zeros((0, 3)), np.zeros((0, 3))),
    np.mgrid[:5, :5].reshape(2, -1).T - 2.0,
    np.array([[-1.0, 0.0], [1.0, 0.0]]),
)
SCENES = [InstancedScene([], [], []), InstancedScene([CUBE], [], np.zeros((0, 4, 4))), InstancedScene([CUBE], [0], ONE)]
NO_ROWS = [
    (lambda: Terrain(FLOOR).top_hits(np.empty((0, 2))).normal, (0, 3)),
    *((lambda r=r: settled(n=0, rules=SettleRules(rule=r)).world_from_vehicle, (0, 4, 4)) for r in REST_RULES),
    (lambda: SCENES[0].bounds, (0, 2, 3)),
    (lambda: fit_support_planes(GRID, np.zeros((0, 25)), np.zeros((0, 25), bool)).gradient, (0, 2)),
    *((lambda s=scene: s.first_hits(RAYS).distance, (0,)) for scene in SCENES),
    *((lambda s=scene: s.occlusion(RAYS), (0,)) for scene in SCENES),
    (lambda: Scene(obstacles=SCENES[2], vehicles=SEEN).first_hits(RAYS).normal, (0, 3)),
    (lambda: measure_visibility(SEEN, Cameras(VGA, ONE[:0]), world=Scene(obstacles=SCENES[1])).fraction, (0,)),
    (lambda: tries(n=0)[0], (0, 2)),
    (lambda: camera_pose(np.zeros(3), np.zeros(0), 0.0, 0.0), (0, 4, 4)),
    (lambda: framed(ONE[:0]).world_from_camera, (0, 4, 4)),
    (lambda: solved(ONE[:0]), (0,)),
    (lambda: Cameras(NO_CAMERA, ONE[:0]).project(POINTS[None]).pixels, (0, 4, 2)),
    (lambda: VehicleBoxes(CRATE).boxes(ONE[:0], Cameras(NO_CAMERA, ONE[:0])).xywh, (0, 4)),
    (lambda: first_equal_indices(np.empty((0, 2))), (0,)),
    (lambda: SCENES[1].bounds, (0, 2, 3)),
]


@pytest.mark.parametrize(("call", "shape"), NO_ROWS)
def test_a_call_with_no_rows_has_none_in_its_result(call, shape):
    assert call().shape == shape


def test_an_empty_world_and_ground_without_area_are_never_met():
    wall = Terrain(Mesh(np.array([[0.0, 0, 0], [1, 1, 0], [0.5, 0.5, 9]]), np.array([[0, 1, 2]])))
    assert not wall.top_hits([[0.5, 0.5], [0, 0]]).hit.any()
    ray = RayList([[0, 0, 1.0]], [DOWN])
    assert not Scene().first_hits(ray).hit.any()
    assert not Scene().occlusion(ray).any()
    for empty in SCENES[:2]:
        assert not empty.first_hits(ray).hit.any()
        assert not empty.occlusion(ray).any()
    assert surface_box(POINTS, np.empty((0, 3), dtype=int), Cameras(VGA, ONE[0])) is None
    assert not fit_support_planes(LINE, np.zeros((3, 2)), np.ones((3, 2), bool)).found.any()


def test_checked_arrays_are_contiguous_float64():
    array = checked_array([[1, 2], [3, 4]], "xy", ("n", 2))
    assert array.dtype == np.float64
    assert array.flags.c_contiguous
    assert np.isinf(checked_array([np.inf], "limit", ("n",), finite=False)).all()
