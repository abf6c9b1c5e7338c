import math

import numpy as np
import pytest

from hulldown.camera.shell import camera_pose, draw_elevation, shell_axes, shell_place


def test_a_level_camera_to_the_east_looks_west_with_north_to_its_right() -> None:
    pose = camera_pose([10.0, 20.0, 5.0], 30.0, 0.0, 0.0)
    np.testing.assert_allclose(pose[:3, 3], [40, 20, 5])
    np.testing.assert_allclose(pose[:3, :3], np.transpose([[0, 1, 0], [0, 0, -1], [-1, 0, 0]]), atol=1e-15)


def test_a_place_on_the_shell_leads_back_to_its_angles() -> None:
    azimuth, elevation = np.array([0.3, -3.1, 2.0, 0.0]), np.array([0.2, -1.2, 1.5, math.pi / 2])
    found = shell_place(7.0 * shell_axes(azimuth, elevation)[0])
    np.testing.assert_allclose(found[0], 7.0, rtol=1e-15)
    np.testing.assert_allclose(found[1:], [azimuth, elevation], atol=1e-15)
    assert [float(each) for each in shell_place(np.zeros(3))] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("distance", "elevation", "message"),
    [
        (0.0, 0.0, r"distance: expected positive meters, got 0.0"),
        (-1.0, 0.0, r"distance"),
        (math.nan, 0.0, r"distance: expected finite"),
        (1.0, 1.6, r"elevation: expected radians from -pi/2 to pi/2, got 1.6"),
        (1.0, -45.0, r"elevation: .*got -45.0"),
    ],
)
def test_impossible_places_are_refused(distance: float, elevation: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        camera_pose([0, 0, 0], distance, 0.0, elevation)


def test_wrong_bounds_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="bounds: expected -pi/2 <= low <= high"):
        draw_elevation(1, (0.5, 0.4), rng=rng)


def test_poses_broadcast_over_everything() -> None:
    assert camera_pose(np.zeros((4, 1, 3)), np.ones(5), 0.0, 0.0).shape == (4, 5, 4, 4)
    assert camera_pose(np.zeros(3), np.zeros(0), 0.0, 0.0).shape == (0, 4, 4)
    outward, axes = shell_axes([0.0, 1.0], 0.2)
    np.testing.assert_allclose(axes[..., 2], -outward)
