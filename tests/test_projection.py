import math

import numpy as np
import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import Camera, project
from hulldown.camera.shell import camera_pose

VGA = Intrinsics(640, 480, math.pi / 2)  # f = 320


def test_pixels_by_hand() -> None:
    projected = Camera(VGA, np.eye(4)).project([[0, 0, 2], [1, 0, 2], [0, 1, 2], [-2, -1.5, 2]])
    # f is 320 but for the rounding of tan(pi / 4).
    np.testing.assert_allclose(projected.pixels, [[320, 240], [480, 240], [320, 400], [0, 0]], atol=1e-12)
    assert projected.depth.tolist() == [2, 2, 2, 2]


def test_points_at_or_behind_the_camera_have_no_pixel_but_a_depth() -> None:
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
