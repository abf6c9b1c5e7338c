import numpy as np
from scipy import stats

from hulldown.placement.candidates import sample_candidates

BOUNDS = np.array([[-10.0, 200.0, -3.0], [30.0, 210.0, 9.0]])


def test_positions_and_headings_are_uniform_in_the_shrunk_bounds_around_the_center():
    xy, yaw = sample_candidates(BOUNDS, 20_000, rng=np.random.default_rng(1))
    for values, low, high in ((xy[:, 0], -6.0, 26.0), (xy[:, 1], 201.0, 209.0), (yaw, -np.pi, np.pi)):
        assert low <= values.min() <= values.max() <= high
        assert stats.kstest(values, "uniform", args=(low, high - low)).pvalue > 1e-3
    # Five standard deviations of the correlation of independent draws.
    assert np.abs(np.corrcoef([*xy.T, yaw]) - np.eye(3)).max() < 5 / np.sqrt(len(xy))


def test_a_longer_draw_begins_with_the_shorter_one():
    short, long = (sample_candidates(BOUNDS, n, rng=np.random.default_rng(3)) for n in (5, 500))
    np.testing.assert_array_equal(short[0], long[0][:5])
    np.testing.assert_array_equal(short[1], long[1][:5])


def test_a_scenery_may_be_a_point():
    xy, _ = sample_candidates([[1.0, 2.0], [1.0, 2.0]], 3, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(xy, [[1.0, 2.0]] * 3)
