"""Boxes that rays cross, compared with testing every pair."""

import numpy as np
import pytest

from hulldown.geometry.boxtree import BoxTree


def _crossed(bounds: np.ndarray, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray) -> set:
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (bounds[None] - origins[:, None, None]) / directions[:, None, None]
    enter, leave = np.nanmax(sides.min(axis=2), axis=2), np.nanmin(sides.max(axis=2), axis=2)
    pairs = np.nonzero((np.maximum(enter, 0.0) <= np.minimum(leave, reach[:, None])) & (leave >= 0.0))
    return set(zip(*(index.tolist() for index in pairs), strict=True))


@pytest.mark.parametrize("toward", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (-1, 1, -1), (0.5, 0, -0.1)])
@pytest.mark.parametrize("spread", [0.0, 0.02, 2.0])
def test_a_bundle_of_rays_crosses_the_boxes_of_its_single_rays(toward: tuple, spread: float) -> None:
    rng = np.random.default_rng(5)
    low = rng.uniform(-40, 40, (300, 3))
    bounds = np.stack([low, low + rng.uniform(0.5, 15, (300, 3))], axis=1)
    origins = np.array([0.3, -0.2, 0.1]) + rng.uniform(-0.5, 0.5, (333, 3)) * min(spread, 1.0)
    directions = np.array(toward, dtype=float) + rng.uniform(-spread, spread, (333, 3))
    reach = rng.choice([10.0, 30.0, np.inf], 333)
    ray, box, _ = BoxTree(bounds).crossed(origins, directions, reach)
    expected = _crossed(bounds, origins, directions, reach)
    assert len(expected) > 0
    assert sorted(zip(ray.tolist(), box.tolist(), strict=True)) == sorted(expected)
