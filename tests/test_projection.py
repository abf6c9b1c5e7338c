import json
import math
import subprocess
import sys

import numpy as np
import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import Camera, project
from hulldown.camera.shell import camera_pose
from hulldown.geometry.transforms import rigid, rotation_about

VGA = Intrinsics(640, 480, math.pi / 2)  # f = 320


def test_points_at_or_behind_the_camera_have_a_depth_but_no_pixel() -> None:
    pixels, depth = Camera(VGA, np.eye(4)).project([[1, 1, 0], [1, 1, -1], [0, 0, -0.0], [0, 0, 1e-300]])
    assert np.isnan(pixels[:3]).all()
    assert np.isfinite(pixels[3]).all()
    assert depth.tolist() == [0, -1, 0, 1e-300]


def test_stacks_of_cameras_broadcast() -> None:
    poses = camera_pose([0, 0, 0], np.full(2, 10.0), [0.0, 3.0], 0.3)
    points = np.random.default_rng(0).normal(size=(7, 3))
    for second in (VGA, Intrinsics(10, 10, 1.0)):
        alone = [Camera(each, pose).project(points).pixels for each, pose in zip((VGA, second), poses, strict=True)]
        np.testing.assert_allclose(project([VGA, second], poses, points).pixels, alone, atol=1e-9)
    np.testing.assert_allclose(project(VGA, poses, points).pixels[0], alone[0], atol=1e-9)
    assert project([], np.zeros((0, 4, 4)), np.zeros((1, 3, 3))).pixels.shape == (0, 3, 2)


@pytest.mark.parametrize("pose", [np.diag([2.0, 2, 2, 1]), np.diag([1.0, 1, -1, 1]), np.eye(4) + 0.1 * np.eye(4, k=-3)])
def test_a_pose_that_is_not_rigid_is_refused(pose: np.ndarray) -> None:
    with pytest.raises(ValueError, match="world_from_camera: expected a rigid 4x4 transform"):
        Camera(VGA, pose)


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
        pose = pose @ rigid(rotation_about([0.0, 0.0, 1.0], 0.2), np.zeros(3))
        camera = Camera(Intrinsics(width, height, math.radians(fov_deg)), pose)
        points = camera.unproject(rng.uniform(-0.5, 1.5, (20, 2)) * [width, height], rng.uniform(2, 40, 20))
        size = {"width": width, "height": height, "fov_x": camera.intrinsics.fov_x}
        cases.append({**size, "world_from_camera": pose.tolist(), "points": points.tolist()})
        pixels, depth = camera.project(points)
        expected.append(np.column_stack([pixels / [width, height] * [1, -1] + [0, 1], depth]))
    command = [sys.executable, "-c", BLENDER]
    done = subprocess.run(command, input=json.dumps(cases), capture_output=True, text=True, check=True, timeout=120)
    result = json.loads(done.stdout.split("RESULT")[1])
    # Blender's matrices are float32: seven digits of coordinates up to 30 m, with f up to 3 widths.
    np.testing.assert_allclose(result, expected, atol=2e-5, rtol=2e-6)
