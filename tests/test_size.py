import math

import numpy as np
import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.camera.size import solve_distance

HD = Intrinsics(1920, 1080, math.radians(50))
POINTS = np.random.default_rng(0).uniform(-1, 1, (60, 3)) * [3.5, 1.7, 1.2]


def test_a_size_that_no_distance_gives_is_nan() -> None:
    # The closest point stays in the center, so the height stays below that of the far corners.
    arrow = np.array([[5.0, 0, 0], [-1, 1, 1], [-1, -1, 1], [-1, 0, -1]])
    pose = camera_pose([0, 0, 0], 50.0, 0.0, 0.0)[None]
    limit = 2 * HD.f_px / 6
    wanted = limit * np.array([0.999, 1.001])
    below, above = solve_distance(HD, np.repeat(pose, 2, axis=0), arrow[None], center=[0, 0, 0], pixels=wanted)
    assert np.isfinite(below)
    assert np.isnan(above)
    point = solve_distance(HD, pose, np.zeros((1, 1, 3)), center=[0, 0, 0], pixels=1.0)
    assert np.isnan(point).all()
    assert solve_distance(HD, pose[:0], arrow[None], center=[0, 0, 0], pixels=1.0).shape == (0,)


@pytest.mark.parametrize("options", [{"pixels": 0.0}, {"center": [100.0, 0, 0]}])
def test_wrong_calls_are_refused(options: dict) -> None:
    (name,) = options
    pose = camera_pose([0, 0, 0], 50.0, 0.0, 0.0)[None]
    with pytest.raises(ValueError, match=f"{name}: expected"):
        solve_distance(HD, pose, POINTS[None], **{"center": [0, 0, 0], "pixels": 10.0} | options)
