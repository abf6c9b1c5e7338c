import numpy as np

from hulldown.placement.footprint import Samples
from hulldown.placement.rest import averaged, least_squares, support

SAMPLES = np.stack(np.meshgrid(np.linspace(-3, 4, 5), np.linspace(-1.5, 2, 4), indexing="ij"), -1).reshape(-1, 2)

PLATE = Samples(SAMPLES, np.zeros(20), np.ones(20, dtype=bool), np.array([0.5, 0.25]))


def rows(seed, k=30):
    rng = np.random.default_rng(seed)
    normals = np.concatenate([rng.normal(0, 0.5, (k, 20, 2)), np.ones((k, 20, 1))], axis=2)
    valid = rng.random((k, 20)) < 0.7
    heights = np.where(valid, rng.normal(40, 1, (k, 20)), np.nan)
    normals[~valid] = np.nan
    return heights, normals / np.linalg.norm(normals, axis=2, keepdims=True), valid


def test_least_squares_agrees_with_a_general_solver():
    heights, _, valid = rows(1)
    rest = least_squares(SAMPLES, heights, valid)
    assert rest.found.all()
    for i, seen in enumerate(valid):
        design = np.column_stack([SAMPLES, np.ones(20)])[seen]
        gx, gy, z = np.linalg.lstsq(design, heights[i, seen], rcond=None)[0]
        np.testing.assert_allclose([*rest.gradient[i], rest.height[i]], [gx, gy, z], atol=1e-11)


def test_the_average_uses_only_valid_hits():
    heights, normals, valid = rows(2)
    rest = averaged(SAMPLES, heights, normals, valid)
    for i, seen in enumerate(valid):
        mean = normals[i, seen].mean(axis=0)
        np.testing.assert_allclose(rest.gradient[i], -mean[:2] / mean[2], atol=1e-13)
        middle = SAMPLES[seen].mean(axis=0)
        np.testing.assert_allclose(rest.height[i] + rest.gradient[i] @ middle, heights[i, seen].mean(), atol=1e-12)


def test_hits_on_one_line_or_none_give_no_plane():
    heights, normals = np.zeros((3, 20)), np.tile([0.0, 0.0, 1.0], (3, 20, 1))
    valid = np.array([np.zeros(20, bool), np.arange(20) < 4, np.arange(20) == 7])
    assert least_squares(SAMPLES, heights, valid).found.tolist() == [False] * 3
    assert support(PLATE, heights, valid).found.tolist() == [False] * 3
    assert averaged(SAMPLES, heights, normals, valid).found.tolist() == [False, True, True]
