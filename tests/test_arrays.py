import numpy as np
import pytest

from hulldown.geometry.arrays import checked, whole


def test_lists_become_contiguous_float64():
    array = checked([[1, 2], [3, 4]], "xy", ("n", 2))
    assert array.dtype == np.float64
    assert array.flags.c_contiguous


@pytest.mark.parametrize(
    ("value", "shape", "dtype", "message"),
    [
        ([1.0, 2.0], ("n", 2), float, r"xy: expected shape \(n, 2\), got \(2,\)"),
        ([[1.0, 2.0, 3.0]], ("n", "n"), float, r"xy: expected shape \(n, n\), got \(1, 3\)"),
        ([[0.0, np.nan]], ("n", 2), float, r"xy: expected finite numbers, got nan at index \(0, 1\)"),
        ([[0.0, 1.0], [-np.inf, 0.0]], ("n", 2), float, r"xy: expected finite numbers, got -inf at index \(1, 0\)"),
        ("here", ("n", 2), float, r"xy: expected float64 array of shape \(n, 2\), got 'here'"),
        ([1.0, 2.0 + 1j], (2,), float, r"xy: expected float64 array of shape \(2,\), got"),
        ([[1.5]], ("n", 1), np.int64, r"xy: expected int64 array of shape \(n, 1\)"),
        ([1.0], (3,), float, r"xy: expected shape \(3,\), got \(1,\)"),
    ],
)
def test_the_error_names_what_is_wrong(value, shape, dtype, message):
    with pytest.raises(ValueError, match=message):
        checked(value, "xy", shape, dtype=dtype)


def test_infinities_are_accepted_if_declared():
    assert np.isinf(checked([np.inf], "limit", ("n",), finite=False)).all()


@pytest.mark.parametrize("value", [2.5, 2.0, "2", True, None, float("nan")])
def test_values_that_are_not_integers_are_refused_as_whole_numbers(value):
    with pytest.raises(ValueError, match="n: expected a whole number, got"):
        whole(value, "n")
