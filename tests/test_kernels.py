"""The same plan on every processor: BLAS kernels, NumPy's SIMD and the C library's functions play no part in it."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import pytest

from hulldown.tests.kernels import QUICK, planned_under, worlds

pytestmark = pytest.mark.thorough
IMAGES = 320


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    # The worlds are made once: their hills are sines, which differ between processors.
    made = tmp_path_factory.mktemp("kernels") / "worlds"
    made.write_bytes(pickle.dumps(worlds(IMAGES)))
    with ThreadPoolExecutor(2) as pool:
        return dict(zip(QUICK, pool.map(lambda one: planned_under(one, made), QUICK.values()), strict=True))


@pytest.mark.parametrize("kernel", QUICK)
def test_rows_are_the_same_to_the_byte(plans, kernel):
    assert len(plans[kernel]) == IMAGES
    assert plans[kernel] == plans["SkylakeX"]
