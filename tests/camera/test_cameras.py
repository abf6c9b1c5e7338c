"""Cameras: equations of the field of view, projection, shells of poses, framing, and distances for a size."""

import itertools
import json
import math
import subprocess
import sys

import numpy as np
import pytest

from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import turn_cameras_to_targets
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose, outward_and_camera_axes, shell_coordinates
from hulldown.camera.size import solve_distance
from hulldown.geometry.transforms import axis_rotation, rigid_matrix
from hulldown.tests.builders.cameras import unproject

VGA = Intrinsics(640, 480, math.pi / 2)  # f = 320


def test_equations_2_to_6_for_the_papers_image() -> None:
    hd = Intrinsics(1920, 1080, math.radians(60))
    # Equations 2 and 3 by hand: 2 atan(tan(30 deg) * 9 / 16).
    fov_y = 2 * math.atan(hd.half_tangents[1])
    assert math.degrees(fov_y) == pytest.approx(35.98339777135764, abs=1e-12)
    assert hd.f_px == pytest.approx((1080 / 2) / math.tan(fov_y / 2), rel=1e-15)
    # Equation 6 by hand: 2 m at 20 % of 1080 pixels, f = 960 / tan(30 deg).
    assert hd.target_distance(2.0, 0.2) == pytest.approx(2.0 * 960 * math.sqrt(3) / 216, rel=1e-15)


@pytest.mark.parametrize("fov_deg", [0.1, 1, 60, 120, 179])
def test_a_point_at_half_the_field_of_view_is_at_the_images_edge(fov_deg: float) -> None:
    camera = Intrinsics(1920, 1080, math.radians(fov_deg))
    assert camera.f_px * math.tan(camera.fov_x / 2) == pytest.approx(960, rel=1e-14)
    assert camera.half_tangents == pytest.approx((960 / camera.f_px, 540 / camera.f_px), rel=1e-12)
    # A row has 12 decimals.
    assert camera.fov_x_deg.round(12) == fov_deg
    assert (
        Intrinsics.from_record_fields(1920, 1080, fov_x_deg=fov_deg)
        == camera
        == camera.with_size(480, 270).with_size(1920, 1080)
    )


def test_points_at_or_behind_the_camera_have_a_depth_but_no_pixel() -> None:
    pixels, depth = Cameras(VGA, np.eye(4)).project([[1, 1, 0], [1, 1, -1], [0, 0, -0.0], [0, 0, 1e-300]])
    assert np.isnan(pixels).all(axis=1).tolist() == [True, True, True, False]
    assert np.isfinite(pixels[3]).all()
    assert depth.tolist() == [0, -1, 0, 1e-300]


def test_stacks_of_cameras_broadcast() -> None:
    poses = camera_pose([0, 0, 0], np.full(2, 10.0), [0.0, 3.0], 0.3)
    points = np.random.default_rng(0).normal(size=(7, 3))
    for second in (VGA, Intrinsics(640, 480, 1.0)):
        alone = [Cameras(each, pose).project(points).pixels for each, pose in zip((VGA, second), poses, strict=True)]
        both = Intrinsics(640, 480, np.array([VGA.fov_x, second.fov_x]))
        np.testing.assert_allclose(Cameras(both, poses).project(points).pixels, alone, atol=1e-9)
        swapped = Cameras(both, poses).take(np.array([1, 0])).project(points)
        np.testing.assert_allclose(swapped.pixels, alone[::-1], atol=1e-9)
    np.testing.assert_allclose(Cameras(VGA, poses).project(points).pixels[0], alone[0], atol=1e-9)


BLENDER = """
import json, sys
import bpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector
scene = bpy.context.scene
data = bpy.data.cameras.new("camera")
camera = bpy.data.objects.new("camera", data)
scene.collection.objects.link(camera)
data.sensor_fit = "HORIZONTAL"
out = []
for case in json.load(sys.stdin):
    scene.render.resolution_x, scene.render.resolution_y = case["width"], case["height"]
    data.angle_x = case["fov_x"]
    # Blender's cameras look along -z with y up.
    flip = Matrix(((1, 0, 0, 0), (0, -1, 0, 0), (0, 0, -1, 0), (0, 0, 0, 1)))
    camera.matrix_world = Matrix(case["world_from_camera"]) @ flip
    bpy.context.view_layer.update()
    out.append([list(world_to_camera_view(scene, camera, Vector(p))) for p in case["points"]])
print("RESULT" + json.dumps(out))
"""


@pytest.mark.blender
def test_projection_equals_blenders_world_to_camera_view_in_float32() -> None:
    rng = np.random.default_rng(5)
    cases, expected = [], []
    for width, height, fov_deg in [(1920, 1080, 60), (640, 480, 20), (300, 900, 35), (1000, 1000, 110)]:
        pose = camera_pose(rng.uniform(-5, 5, 3), 20.0, rng.uniform(0, 6), rng.uniform(-1.5, 1.5))
        pose = pose @ rigid_matrix(axis_rotation([0.0, 0.0, 1.0], 0.2), np.zeros(3))
        camera = Cameras(Intrinsics(width, height, math.radians(fov_deg)), pose)
        points = unproject(camera, rng.uniform(-0.5, 1.5, (20, 2)) * [width, height], rng.uniform(2, 40, 20))
        size = {"width": width, "height": height, "fov_x": camera.lenses.fov_x}
        cases.append({**size, "world_from_camera": pose.tolist(), "points": points.tolist()})
        pixels, depth = camera.project(points)
        expected.append(np.column_stack([pixels / [width, height] * [1, -1] + [0, 1], depth]))
    command = [sys.executable, "-c", BLENDER]
    done = subprocess.run(command, input=json.dumps(cases), capture_output=True, text=True, check=True, timeout=120)
    result = json.loads(done.stdout.split("RESULT")[1])
    # Blender's matrices are float32: seven digits of coordinates up to 30 m, with f up to 3 widths.
    np.testing.assert_allclose(result, expected, atol=2e-5, rtol=2e-6)


def test_a_level_camera_in_the_east_looks_west_with_north_to_its_right() -> None:
    pose = camera_pose([10.0, 20.0, 5.0], 30.0, 0.0, 0.0)
    np.testing.assert_allclose(pose[:3, 3], [40, 20, 5])
    np.testing.assert_allclose(pose[:3, :3], np.transpose([[0, 1, 0], [0, 0, -1], [-1, 0, 0]]), atol=1e-15)
    poses = camera_pose(np.zeros((4, 1, 3)), np.ones(5), np.arange(5), [-math.pi / 2, -0.4, 0.0, 1.0, math.pi / 2])
    assert poses.shape == (4, 5, 4, 4)
    assert (poses[..., 2, 0] == 0.0).all()


def test_a_position_on_the_shell_has_its_angles() -> None:
    azimuth, elevation = np.array([0.3, -3.1, 2.0, 0.0]), np.array([0.2, -1.2, 1.5, math.pi / 2])
    found = shell_coordinates(7.0 * outward_and_camera_axes(azimuth, elevation)[0])
    np.testing.assert_allclose(found[0], 7.0, rtol=1e-15)
    np.testing.assert_allclose(found[1:], [azimuth, elevation], atol=1e-15)
    assert [float(each) for each in shell_coordinates(np.zeros(3))] == [0.0, 0.0, 0.0]


def test_cuts_of_each_side_and_corner_are_as_frequent_and_as_deep_as_their_area() -> None:
    # The reference: uniform positions in the plane, restricted to a narrow range of shares.
    size, extent = np.array([2000.0, 1000.0]), np.array([300.0, 500.0])
    rng = np.random.default_rng(0)
    place = rng.uniform(-extent, size, (2_000_000, 2))
    inside = np.clip(np.minimum(place + extent, size) - np.maximum(place, 0), 0, None) / extent
    place = place[np.abs(inside.prod(axis=1) - 0.4) < 0.005]
    # With a long lens, an upright rectangle has the same image anywhere.
    lens = Intrinsics(2000, 1000, math.radians(0.2))
    corners = np.array([[0, y, z] for y in (-1.5, 1.5) for z in (-2.5, 2.5)])
    pose = np.tile(camera_pose([0, 0, 0], 20 / (2 * math.tan(math.radians(0.1))), 0.0, 0.0), (20_000, 1, 1))
    framed = turn_cameras_to_targets(Cameras(lens, pose), corners[None], rng=rng, truncated=(0.6, 0.6))
    found = framed.project(corners).pixels.min(axis=1)
    beyond, expected = ((at + extent > size + 0.1).astype(int) - (at < -0.1) for at in (found, place))
    for sides in itertools.product((-1, 0, 1), repeat=2):
        here, there = (beyond == sides).all(axis=1), (expected == sides).all(axis=1)
        assert here.mean() == pytest.approx(there.mean(), abs=0.015)
        if any(sides):
            np.testing.assert_allclose(np.std(found[here], axis=0), np.std(place[there], axis=0), rtol=0.1, atol=3)


def test_a_target_is_cut_as_far_as_a_distorted_lens_sees_it() -> None:
    # Where the lens folds, just outside the image, half of the targets don't have their place. It was a traceback.
    folds = Intrinsics.calibrated(1920, 1080, (1420.0, 1420.0, 960.0, 540.0), (-0.2, 0.0, 0.0, 0.0, 0.0))
    corners = np.array([[x, y, z] for x in (-3.5, 3.5) for y in (-1.7, 1.7) for z in (-1.2, 1.2)])
    poses = camera_pose([0, 0, 0], np.full(200, 14.0), np.linspace(0, 6, 200), 1.0)
    framed = turn_cameras_to_targets(Cameras(folds, poses), corners[None], rng=np.random.default_rng(0), truncated=(0.8, 0.8))
    pixels = framed.project(corners).pixels
    low, high = pixels.min(axis=1), pixels.max(axis=1)
    cut = 1 - (np.clip(np.minimum(high, folds.size) - np.maximum(low, 0), 0, None) / (high - low)).prod(axis=1)
    assert (cut <= 0.8 + 1e-5).all()
    assert np.sum(cut >= 0.8 - 1e-5) > 50


def test_cameras_inside_the_targets_box_are_unchanged() -> None:
    inside = camera_pose([0, 0, 0], np.ones(1), 0.3, 0.1)
    corners = np.array([[x, y, z] for x in (-3.5, 3.5) for y in (-1.7, 1.7) for z in (-1.2, 1.2)])
    framed = turn_cameras_to_targets(Cameras(VGA, inside), corners[None], rng=np.random.default_rng(0))
    np.testing.assert_array_equal(framed.world_from_camera, inside)


def test_a_size_that_no_distance_gives_is_nan() -> None:
    # The closest point stays in the center, so the height stays below that of the far corners.
    arrow = np.array([[5.0, 0, 0], [-1, 1, 1], [-1, -1, 1], [-1, 0, -1]])
    poses = np.tile(camera_pose([0, 0, 0], 50.0, 0.0, 0.0), (2, 1, 1))
    wanted = 2 * VGA.f_px / 6 * np.array([0.999, 1.001])
    found = solve_distance(Cameras(VGA, poses), arrow[None], center=[0, 0, 0], pixels=wanted)
    assert np.isfinite(found).tolist() == [True, False]
    assert np.isnan(solve_distance(Cameras(VGA, poses), np.zeros((1, 1, 3)), center=[0, 0, 0], pixels=1.0)).all()
