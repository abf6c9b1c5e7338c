"""A distorting lens: OpenCV's formula, its inverse, its fold, and its effect on cameras and boxes."""

import math

import cv2
import numpy as np
import pytest

from hulldown.annotate.boxes import VehicleBoxes, surface_box
from hulldown.base.errors import ConfigError
from hulldown.camera.cameras import Cameras
from hulldown.camera.distortion import distort_points, max_seen_radius, undistort_points
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.geometry.transforms import axis_rotation, rigid_matrix
from hulldown.tests.builders.cameras import unproject
from hulldown.tests.builders.planning_assets import filled_share, plan, small_assets, small_config, vehicle
from hulldown.tests.builders.shapes import sheet
from hulldown.tests.oracles.curves import LENSES

PINHOLE = (1420.0, 1418.5, 964.2, 545.7)
every_lens = pytest.mark.parametrize("name", LENSES)


def points_within(radius, n=5000):
    rng = np.random.default_rng(0)
    r, angle = min(radius, 3.0) * np.sqrt(rng.random(n)), rng.uniform(0, 2 * math.pi, n)
    return np.stack([r * np.cos(angle), r * np.sin(angle)], 1)


@every_lens
def test_points_equal_opencvs_and_round_trip(name):
    lens = LENSES[name]
    points = points_within(max_seen_radius(lens))
    image = distort_points(points, lens)
    placed, _ = cv2.projectPoints(np.c_[points, np.ones(len(points))], *np.zeros((2, 3)), np.eye(3), np.array(lens))
    np.testing.assert_allclose(image, placed[:, 0], atol=1e-12)
    back = undistort_points(image, lens, max_seen_radius(lens))
    np.testing.assert_allclose(back, points, atol=1e-12)
    alone = [undistort_points(each[None], lens, max_seen_radius(lens))[0] for each in image[:100]]
    np.testing.assert_array_equal(alone, back[:100])


@every_lens
def test_a_camera_projects_and_casts_rays_like_opencv(name):
    intrinsics = Intrinsics.calibrated(1920, 1080, PINHOLE, LENSES[name])
    pose = rigid_matrix(axis_rotation([0.6, 0.0, 0.8], 0.7), [1.0, 2.0, 3.0])
    camera = Cameras(intrinsics, pose)
    pixels = np.random.default_rng(1).uniform(0, [1920, 1080], (2000, 2))
    depth = np.random.default_rng(2).uniform(0.2, 100, 2000)
    points = unproject(camera, pixels, depth)
    lens, world = np.array(LENSES[name]), np.linalg.inv(pose)
    seen, _ = cv2.projectPoints(points, cv2.Rodrigues(world[:3, :3])[0], world[:3, 3], intrinsics.matrix, lens)
    np.testing.assert_allclose(seen[:, 0], pixels, atol=1e-7)
    np.testing.assert_allclose(camera.project(points).pixels, pixels, atol=1e-8)
    ahead = camera.rays(pixels)[1] * np.linalg.norm(points - camera.position, axis=1)[:, None]
    np.testing.assert_allclose(camera.position + ahead, points, atol=1e-12)


def test_nothing_is_visible_beyond_the_fold():
    # 1 - 3 * 0.2 r^2 = 0
    fold = 1 / math.sqrt(3 * 0.2)
    assert max_seen_radius(LENSES["folding"]) == pytest.approx(0.999 * fold, rel=1e-12)
    camera = Cameras(Intrinsics.calibrated(1920, 1080, PINHOLE, LENSES["folding"]), np.eye(4))
    pixels, depth = camera.project([[1.2, 0.0, 1.0], [1.3, 0.0, 1.0], [0.0, 3.0, 1.0]])
    assert np.isnan(pixels[:, 0]).tolist() == [False, True, True]
    assert depth.tolist() == [1.0] * 3
    assert np.isnan(undistort_points(np.array([[1e9, 0.0], [np.nan, 0.0]]), LENSES["folding"], 1.0)).all()
    # An unlimited wall ends at the circle of the fold.
    wall = sheet((-50, -50), (50, 50), 2.0)
    box = surface_box(wall.vertices, wall.faces, camera, frame=False)
    radius = 0.999 * fold * (1 - 0.2 * (0.999 * fold) ** 2)
    np.testing.assert_allclose(box[2:], 2 * radius * np.array(PINHOLE[:2]), rtol=1e-9)
    assert surface_box(wall.vertices, wall.faces, camera).tolist() == [0.0, 0.0, 1920.0, 1080.0]


def test_boxes_of_objects_beside_the_camera_are_finite():
    intrinsics = Intrinsics.calibrated(160, 90, (140.0, 139.0, 82.0, 44.0), (-0.2, 0.05, 1e-3, -1e-3, 0.0))
    camera = Cameras(intrinsics, np.eye(4))
    wall = np.array([[2.0, -1.0, 0.0], [2.0, 1.0, 0.0], [2.0, 1.0, 9.0], [2.0, -1.0, 9.0]])
    x, y, w, h = surface_box(wall * 1e4, [[0, 1, 2], [0, 2, 3]], camera, frame=False)
    assert max(-x, -y, x + w, y + h) == 1e9  # plans have numbers up to 1e12


def test_a_lens_that_folds_inside_the_image_is_refused():
    matrix = {"fx": 800.0, "fy": 800.0, "cx": 960.0, "cy": 540.0}
    with pytest.raises(ConfigError, match=r"camera.distortion: .*folds at 1.29"):
        small_config(camera={"intrinsics": matrix, "distortion": {"k1": -0.2}})
    with pytest.raises(ConfigError, match=r"camera\.intrinsics"):
        small_config(camera={"distortion": {"k1": -0.2}})


@every_lens
def test_a_vehicles_boxes_are_those_of_its_surface(name):
    lens, shape = Intrinsics.calibrated(1920, 1080, PINHOLE, LENSES[name]), vehicle("t72")
    boxes, rng = VehicleBoxes(shape), np.random.default_rng(3)
    for _ in range(20):
        pose = camera_pose(rng.normal(size=3) * 3, 10 ** rng.uniform(0, 1.8), rng.uniform(0, 6), rng.uniform(-0.5, 1.2))
        found = boxes.boxes(np.eye(4)[None], Cameras(lens, pose[None]))
        for frame, box in ((True, found.xywh[0]), (False, found.amodal[0])):
            wanted = surface_box(shape.mesh.vertices, shape.mesh.faces, Cameras(lens, pose), frame=frame)
            np.testing.assert_allclose(box, np.full(4, np.nan) if wanted is None else wanted, atol=1e-6, rtol=1e-9)


@pytest.mark.parametrize("measure", ["height", "area"])
def test_planned_sizes_and_cuts_are_exact_in_the_distorted_image(measure):
    matrix, lens = dict(zip(("fx", "fy", "cx", "cy"), PINHOLE, strict=True)), LENSES["calibrated"]
    camera = {
        "intrinsics": matrix, "distortion": dict(zip(("k1", "k2", "p1", "p2", "k3"), lens, strict=True)),
        "size_measure": measure, "target_fraction": 0.2, "truncated_fraction": [0.0, 0.3], "framing": 1.0,
    }  # fmt: skip
    rows = list(plan(small_config(camera=camera, budget={"images_per_class": 4}), small_assets()))
    for row in rows:
        assert row.dist == lens
        assert row.intrinsics == Intrinsics.calibrated(1920, 1080, PINHOLE, lens)
        assert filled_share(row.target.bbox_amodal[2:], row, measure) == pytest.approx(0.2, abs=1e-8)
        assert 0.0 <= row.target.truncated_fraction <= 0.3


def test_the_bounds_of_an_image_contain_all_its_rays():
    for lens in LENSES.values():
        intrinsics = Intrinsics.calibrated(1920, 1080, PINHOLE, lens)
        low, high = intrinsics.window
        pixels = np.stack(np.meshgrid(np.linspace(0, 1920, 200), np.linspace(0, 1080, 113)), -1).reshape(-1, 2)
        unit = intrinsics.unit_points_from_pixels(pixels)
        assert (unit >= low).all()
        assert (unit <= high).all()
        np.testing.assert_allclose([unit.min(axis=0), unit.max(axis=0)], [low, high], atol=0.01)
