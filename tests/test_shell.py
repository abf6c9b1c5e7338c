import math

import numpy as np
import pytest

from hulldown.camera.shell import camera_pose, draw_elevation, shell_axes, shell_place


def test_a_level_camera_in_the_east_looks_west_with_north_to_its_right() -> None:
    pose = camera_pose([10.0, 20.0, 5.0], 30.0, 0.0, 0.0)
    np.testing.assert_allclose(pose[:3, 3], [40, 20, 5])
    np.testing.assert_allclose(pose[:3, :3], np.transpose([[0, 1, 0], [0, 0, -1], [-1, 0, 0]]), atol=1e-15)


def test_a_position_on_the_shell_has_its_angles() -> None:
    azimuth, elevation = np.array([0.3, -3.1, 2.0, 0.0]), np.array([0.2, -1.2, 1.5, math.pi / 2])
    found = shell_place(7.0 * shell_axes(azimuth, elevation)[0])
    np.testing.assert_allclose(found[0], 7.0, rtol=1e-15)
    np.testing.assert_allclose(found[1:], [azimuth, elevation], atol=1e-15)
    assert [float(each) for each in shell_place(np.zeros(3))] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("distance", "elevation", "name"),
    [(0.0, 0.0, "distance"), (math.nan, 0.0, "distance"), (1.0, 1.6, "elevation"), (1.0, -45.0, "elevation")],
)
def test_impossible_positions_are_refused(distance: float, elevation: float, name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected"):
        camera_pose([0, 0, 0], distance, 0.0, elevation)


def test_wrong_bounds_are_refused() -> None:
    with pytest.raises(ValueError, match="bounds: expected"):
        draw_elevation(1, (0.5, 0.4), rng=np.random.default_rng(0))


def test_poses_broadcast_and_are_level() -> None:
    poses = camera_pose(np.zeros((4, 1, 3)), np.ones(5), np.arange(5), [-math.pi / 2, -0.4, 0.0, 1.0, math.pi / 2])
    assert poses.shape == (4, 5, 4, 4)
    assert (poses[..., 2, 0] == 0.0).all()
    assert camera_pose(np.zeros(3), np.zeros(0), 0.0, 0.0).shape == (0, 4, 4)
