"""Counter-based random numbers: independent of batching, uniform, and different for each purpose."""

import numpy as np
import pytest
from scipy import stats

from hulldown.planning.search.random_streams import Purpose, RandomStreams, RowStreams, choose_weighted_indices, scale_uniform


def test_a_row_does_not_depend_on_other_rows():
    draws = RandomStreams(7)
    items, tries = np.arange(100), np.arange(100) % 5
    together = draws.uniform(Purpose.PLACE, items, tries, count=6)
    for i in (0, 17, 99):
        alone = draws.uniform(Purpose.PLACE, items[i], tries[i], count=6)
        assert np.array_equal(alone[0], together[i])
    assert np.array_equal(draws.uniform(Purpose.PLACE, items, tries, count=2), together[:, :2])


def test_numbers_are_uniform_and_uncorrelated_along_every_axis():
    draws = RandomStreams(0)
    values = draws.uniform(Purpose.PLACE, np.arange(4000), 0, count=8)
    assert stats.kstest(values.ravel(), "uniform").pvalue > 1e-3
    tries = draws.uniform(Purpose.PLACE, 3, np.arange(4000), count=8)
    assert stats.kstest(tries.ravel(), "uniform").pvalue > 1e-3
    for a, b in [(values[:-1], values[1:]), (values[:, :-1], values[:, 1:]), (values, tries)]:
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(a.size)


def test_no_two_streams_share_a_number():
    draws = RandomStreams(0)
    bits = [draws.random_bits(p, np.arange(500), t, count=10) for p in Purpose for t in range(3)]
    bits += [RandomStreams(1).random_bits(Purpose.PLACE, np.arange(500), 0, count=10)]
    flat = np.concatenate([b.ravel() for b in bits])
    assert len(np.unique(flat)) == len(flat)


def test_the_numbers_of_a_seed_never_change():
    # Later versions give the same plan.
    assert RandomStreams(42).random_bits(Purpose.PLACE, 3, 1, count=2).tolist() == [[3236006953506002898, 3480301495620565934]]


def test_a_generator_by_row_uses_a_separate_stream_for_each_row():
    draws = RandomStreams(5)
    rng = RowStreams(draws, Purpose.CAMERA, np.arange(10), 2)
    first, second = rng.random((10, 3)), rng.random(10)
    expected = draws.uniform(Purpose.CAMERA, np.arange(10), 2, count=4)
    assert np.array_equal(np.column_stack([first, second]), expected)
    again = RowStreams(draws, Purpose.CAMERA, np.arange(10), 2)
    assert np.array_equal(again.uniform(-1.0, 1.0, (10, 3)), scale_uniform(-1.0, 1.0, expected[:, :3]))


def test_a_generator_by_row_refuses_unsupported_calls():
    rng = RowStreams(RandomStreams(5), Purpose.CAMERA, np.arange(10), 0)
    with pytest.raises(ValueError, match="size: expected 10 rows"):
        rng.random((3, 2))


def test_choices_follow_their_weights_and_zero_weights_are_never_chosen():
    u = (np.arange(100_000) + 0.5) / 100_000
    assert np.bincount(choose_weighted_indices([1.0, 0.0, 3.0], u)).tolist() == [25_000, 0, 75_000]
    numbers = [0.0, np.nextafter(0.5, 0.0), 0.5, 1.0 - 2.0**-53]
    assert choose_weighted_indices([0.0, 1.0, 1.0, 0.0], numbers).tolist() == [1, 1, 2, 2]
    assert choose_weighted_indices([[0.0, 1.0, 1.0, 0.0]] * 3 + [[2.0, 0.0, 0.0, 0.0]], numbers).tolist() == [1, 1, 2, 0]
    assert choose_weighted_indices([0.0, 0.0], []).tolist() == []
    with pytest.raises(ValueError, match="weights"):
        choose_weighted_indices([[1.0, 0.0], [0.0, 0.0]], [0.5, 0.5])


def test_between_never_leaves_its_bounds():
    u = np.array([0.0, 0.5, 1.0 - 2.0**-53])
    assert scale_uniform(0.1, 0.3, u).max() <= 0.3
    assert scale_uniform(2.0, 2.0, u).tolist() == [2.0, 2.0, 2.0]
