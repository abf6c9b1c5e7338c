import numpy as np
import pytest

from hulldown.base.errors import ConfigError
from hulldown.training.inputs.data import fill_source_shares, make_draws


def test_a_row_is_a_function_of_seed_and_number_alone():
    few, many = make_draws([7, 30], 50, seed=3), make_draws([7, 30], 500, seed=3)
    for column in ("source", "image", "seed"):
        np.testing.assert_array_equal(getattr(few, column), getattr(many, column)[:50])
    assert (make_draws([7, 30], 50, seed=4).image != few.image).any()


def test_the_first_draws_of_seed_0_never_change():
    draws = make_draws([21, 420], 5, seed=0)
    assert draws.source.tolist() == [0, 1, 1, 1, 1]
    assert draws.image.tolist() == [5, 210, 414, 298, 107]
    assert draws.seed.tolist() == [478570405, 1192306873, 1090160368, 563777444, 3715313275]


def test_draws_are_uniform_over_the_union_as_in_the_paper():
    sizes, budget = [21, 420], 100_000
    draws = make_draws(sizes, budget, seed=1)
    counts = np.bincount(draws.image + np.array([0, 21])[draws.source], minlength=sum(sizes))
    assert counts.sum() == budget
    mean = budget / sum(sizes)
    # Chi-squared with 440 degrees of freedom has mean 440 and standard deviation 30.
    assert 440 - 150 < ((counts - mean) ** 2 / mean).sum() < 440 + 150


@pytest.mark.parametrize(("share", "expected"), [(0.5, [0.5, 0.125, 0.375]), (0.0, [0, 0.25, 0.75])])
def test_given_shares_hold_and_the_rest_is_by_size(share, expected):
    sizes = [10, 20, 60]
    shares = fill_source_shares(dict(zip(("real", "a", "b"), sizes, strict=True)), {"real": share})
    draws = make_draws(sizes, 20_000, seed=0, shares=shares)
    found = np.bincount(draws.source, minlength=3) / 20_000
    np.testing.assert_allclose(found, expected, atol=0.02)  # six standard deviations
    if share == 0.0:
        assert found[0] == 0.0


def test_shares_of_all_sources_add_up_to_1():
    assert fill_source_shares({"a": 1, "b": 1}, {"a": 0.25, "b": 0.75}) == [0.25, 0.75]
    for shares, message in (
        ({"c": 0.5}, r"shares\.c: no source has this name; there are a, b"),
        ({"a": 1.5}, r"shares\.a = 1\.5: expected a number from 0 to 1"),
        ({"a": 0.5, "b": 0.6}, "they add up to 1.1, expected 1; leave one of them out"),
        ({"a": 0.5, "b": 0.4}, "they add up to 0.9, expected 1"),
    ):
        with pytest.raises(ConfigError, match=message):
            fill_source_shares({"a": 1, "b": 1}, shares)
