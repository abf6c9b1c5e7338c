"""Points of a set that can be extreme."""

import numpy as np
import pytest

from hulldown.geometry.hulls import extreme_point_indices

CUBE = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), -1).reshape(-1, 3)


def test_a_cube_has_only_its_corners() -> None:
    inside = np.random.default_rng(0).uniform(0.01, 0.99, (200, 3))
    assert extreme_point_indices(np.concatenate([inside, CUBE])).tolist() == list(range(200, 208))


def test_all_points_of_a_ball_are_kept_far_from_the_origin() -> None:
    ball = np.random.default_rng(0).normal(size=(300, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    assert len(extreme_point_indices(ball + 1e11)) == 300


@pytest.mark.parametrize("points", [CUBE[:0], CUBE[:3], np.zeros((9, 3)), CUBE * [1, 1, 0], CUBE * [1, 0, 0]])
def test_flat_sets_keep_all_points(points: np.ndarray) -> None:
    assert extreme_point_indices(points).tolist() == list(range(len(points)))


def test_points_near_a_corner_are_kept_on_request() -> None:
    twins = CUBE * (1 - 3e-16)  # inside by an ulp or two
    off = CUBE * 0.9 + 0.05
    points = np.concatenate([CUBE, twins, off])
    assert set(extreme_point_indices(points, near=1e-9)) == set(range(16))
    assert len(extreme_point_indices(points)) == 8
