import numpy as np

from hulldown.placement.candidates import candidates

BOUNDS = np.array([[-10.0, 200.0, -3.0], [30.0, 210.0, 9.0]])


def test_positions_fill_the_shrunk_bounds_around_the_center():
    xy, yaw = candidates(BOUNDS, 20_000, rng=np.random.default_rng(1))
    assert (xy >= [-6.0, 201.0]).all()
    assert (xy <= [26.0, 209.0]).all()
    assert (xy.min(axis=0) < [-5.9, 201.1]).all()
    assert (xy.max(axis=0) > [25.9, 208.9]).all()
    assert -np.pi <= yaw.min() < -3.1
    assert 3.1 < yaw.max() < np.pi


def test_a_quarter_of_the_tries_is_in_each_quarter():
    xy, yaw = candidates(BOUNDS, 40_000, rng=np.random.default_rng(2))
    quarter = 2 * (xy[:, 0] > 10) + (xy[:, 1] > 205)
    # Five standard deviations of a binomial count: sqrt(40000 * 1/4 * 3/4) = 87.
    assert np.abs(np.bincount(quarter) - 10_000).max() < 435
    assert np.abs(np.histogram(yaw, bins=4, range=(-np.pi, np.pi))[0] - 10_000).max() < 435


def test_a_longer_draw_begins_with_the_shorter_one():
    short, long = (candidates(BOUNDS, n, rng=np.random.default_rng(3)) for n in (5, 500))
    np.testing.assert_array_equal(short[0], long[0][:5])
    np.testing.assert_array_equal(short[1], long[1][:5])


def test_zero_tries_and_a_point_sized_scenery_are_legal():
    assert candidates(BOUNDS, 0, rng=np.random.default_rng(0))[0].shape == (0, 2)
    xy, _ = candidates([[1.0, 2.0], [1.0, 2.0]], 3, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(xy, [[1.0, 2.0]] * 3)
