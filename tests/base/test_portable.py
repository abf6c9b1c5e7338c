"""Functions with the same results on every processor: close to the truth, and exact where it's a float64."""

import math

import numpy as np
import pytest

from hulldown.base import portable

N = 100_000
RNG = np.random.default_rng(0)
ANGLES = np.concatenate([RNG.uniform(-7, 7, N), RNG.uniform(-1e5, 1e5, N), np.arange(-64, 65) * math.pi / 4])
SPREAD = RNG.normal(size=(2, N)) * 10 ** RNG.uniform(-8, 8, (2, N))


def ulps(got, wanted):
    """Largest error in ulps of the truth, which is a long double."""
    return float((np.abs(got.astype(np.longdouble) - wanted) / np.spacing(np.abs(wanted).astype(float))).max())


def exactly(function, *arguments):
    return function(*(np.asarray(a, dtype=np.longdouble) for a in arguments))


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="long double is the reference, and here no wider")
@pytest.mark.parametrize(
    ("function", "reference", "arguments", "most"),
    [
        (portable.sin, np.sin, [ANGLES], 1.0),
        (lambda x: portable.sin_cos(x)[1], np.cos, [ANGLES], 1.0),
        (lambda x: np.array([portable.tan(a) for a in x.tolist()]), np.tan, [ANGLES[:5000]], 2.5),
        (portable.arctan2, np.arctan2, list(SPREAD), 2.0),
        (portable.arcsin, np.arcsin, [RNG.uniform(-1, 1, N)], 3.0),
        (portable.hypot, np.hypot, list(SPREAD), 1.5),
        (portable.exp, np.exp, [RNG.uniform(-700, 700, N)], 1.0),
        (portable.log, np.log, [10 ** RNG.uniform(-300, 300, N)], 1.0),
        (portable.log, np.log, [RNG.uniform(0.5, 2.0, N)], 1.0),
    ],
)
def test_results_are_within_a_few_ulp(function, reference, arguments, most):
    assert ulps(function(*arguments), exactly(reference, *arguments)) < most


def test_results_that_are_float64_are_exact():
    sine, cosine = portable.sin_cos([0.0])
    assert (sine[0], cosine[0], portable.tan(0.0)) == (0.0, 1.0, 0.0)
    assert portable.exp(0.0) == 1.0
    assert portable.log(1.0) == 0.0
    assert portable.hypot(3.0, -4.0) == 5.0
    quarter = math.pi / 2
    assert portable.arctan2([0, 1, 0, -1, 0], [1, 0, -1, 0, 0]).tolist() == [0.0, quarter, math.pi, -quarter, 0.0]
    assert portable.arcsin([-1.0, 0.0, 1.0]).tolist() == [-quarter, 0.0, quarter]


def test_numbers_and_arrays_give_the_same_bits():
    angles = ANGLES[:200]
    sine, cosine = portable.sin_cos(angles)
    assert all(portable.sin(a) == s for a, s in zip(angles, sine, strict=True))
    inner = np.abs(angles) < math.pi / 4
    assert [portable.tan(a) for a in angles[inner].tolist()] == (sine / cosine)[inner].tolist()
