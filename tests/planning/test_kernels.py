"""Plans don't depend on BLAS kernels, NumPy's SIMD, or the C library's functions."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import pytest

from hulldown.plan.lines import PLAN_MARK
from hulldown.tests.builders.kernels import QUICK, planned_under, worlds

pytestmark = pytest.mark.thorough
IMAGES = 320


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    # The worlds are made once, since sines for their hills differ between processors.
    made = tmp_path_factory.mktemp("kernels") / "worlds"
    made.write_bytes(pickle.dumps(worlds(IMAGES)))
    with ThreadPoolExecutor(2) as pool:
        return dict(zip(QUICK, pool.map(lambda one: planned_under(one, made), QUICK.values()), strict=True))


@pytest.mark.parametrize("kernel", QUICK)
def test_plans_are_equal_to_the_byte(plans, kernel):
    assert sum(line.startswith(PLAN_MARK) for line in plans[kernel]) == len(plans[kernel]) - IMAGES > 0
    assert plans[kernel] == plans["SkylakeX"]
