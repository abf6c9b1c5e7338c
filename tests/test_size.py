import math

import numpy as np
import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.camera.size import solve_distance

HD = Intrinsics(1920, 1080, math.radians(50))
POINTS = np.random.default_rng(0).uniform(-1, 1, (60, 3)) * [3.5, 1.7, 1.2]


def test_a_face_on_square_is_where_equation_6_says() -> None:
    square = np.array([[0, y, z] for y in (-1.0, 1) for z in (-1.0, 1)])
    pose = camera_pose([0, 0, 0], 50.0, 0.0, 0.0)[None]
    found = solve_distance(HD, pose, square[None], center=[0, 0, 0], pixels=0.2 * 1080)
    assert found[0] == pytest.approx(float(HD.distance_for(2.0, 0.2)), rel=1e-14)
    for measure, pixels in [("width", 216.0), ("diagonal", 216 * math.sqrt(2)), ("area", 216.0**2)]:
        again = solve_distance(HD, pose, square[None], center=[0, 0, 0], pixels=pixels, measure=measure)
        assert again[0] == pytest.approx(found[0], rel=1e-14)


def test_a_size_that_no_distance_gives_is_nan() -> None:
    # The point that comes nearest stays in the middle, so the height stays below that of the far corners.
    arrow = np.array([[5.0, 0, 0], [-1, 1, 1], [-1, -1, 1], [-1, 0, -1]])
    pose = camera_pose([0, 0, 0], 50.0, 0.0, 0.0)[None]
    limit = 2 * HD.f_px / 6
    below, above = (
        solve_distance(HD, pose, arrow[None], center=[0, 0, 0], pixels=limit * k)[0] for k in (0.999, 1.001)
    )
    assert np.isfinite(below)
    assert np.isnan(above)
    point = solve_distance(HD, pose, np.zeros((1, 1, 3)), center=[0, 0, 0], pixels=1.0)
    assert np.isnan(point).all()


def test_no_cameras_is_legal() -> None:
    found = solve_distance(HD, np.zeros((0, 4, 4)), POINTS[None], center=[0, 0, 0], pixels=10.0)
    assert found.shape == (0,)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pixels": 0.0}, "pixels: expected positive sizes, got 0.0"),
        ({"center": [100.0, 0, 0]}, "center: expected a point in front of every camera"),
    ],
)
def test_wrong_calls_are_refused(options: dict, message: str) -> None:
    pose = camera_pose([0, 0, 0], 50.0, 0.0, 0.0)[None]
    with pytest.raises(ValueError, match=message):
        solve_distance(HD, pose, POINTS[None], **{"center": [0, 0, 0], "pixels": 10.0} | options)
