"""Which points of a set can be extreme."""

import numpy as np
import pytest

from hulldown.geometry.hulls import extreme_points

CUBE = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), -1).reshape(-1, 3)


def test_the_corners_of_a_cube_and_nothing_else() -> None:
    inside = np.random.default_rng(0).uniform(0.01, 0.99, (200, 3))
    assert extreme_points(np.concatenate([inside, CUBE])).tolist() == list(range(200, 208))


def test_no_point_of_a_ball_is_lost_far_from_the_origin() -> None:
    ball = np.random.default_rng(0).normal(size=(300, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    assert len(extreme_points(ball + 1e11)) == 300


@pytest.mark.parametrize("points", [CUBE[:0], CUBE[:3], np.zeros((9, 3)), CUBE * [1, 1, 0], CUBE * [1, 0, 0]])
def test_all_points_where_there_is_no_body(points: np.ndarray) -> None:
    assert extreme_points(points).tolist() == list(range(len(points)))


def test_what_is_near_a_corner_is_taken_on_request() -> None:
    twins = CUBE * (1 - 3e-16)  # inside by an ulp or two
    off = CUBE * 0.9 + 0.05
    points = np.concatenate([CUBE, twins, off])
    assert set(extreme_points(points, near=1e-9)) == set(range(16))
    assert len(extreme_points(points)) == 8
