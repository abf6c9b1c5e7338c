import itertools

import numpy as np
import pytest

from hulldown.placement.support import NUDGE, support_plane

GRID = np.stack(np.meshgrid(np.linspace(-3.5, 3.5, 5), np.linspace(-1.75, 1.75, 5), indexing="ij"), -1).reshape(-1, 2)


def slow_twin(xy, heights, valid):
    """The highest triangle around the center that carries it, compared with trying all of the dual's."""
    best = -np.inf
    center = NUDGE * np.ptp(xy, axis=0)
    for corners in itertools.combinations(np.flatnonzero(valid), 3):
        system = np.vstack([xy[list(corners)].T, np.ones(3)])
        if abs(np.linalg.det(system)) < 1e-9:
            continue
        weights = np.linalg.solve(system, [*center, 1.0])
        if (weights >= 0).all():
            best = max(best, weights @ heights[list(corners)])
    return best


@pytest.mark.parametrize("share", [1.0, 0.8, 0.3])
def test_the_plane_is_the_lowest_above_all_samples(share):
    rng = np.random.default_rng(11)
    heights = rng.normal(0, 0.3, (40, 25)) + GRID @ [0.1, -0.3]
    valid = rng.random((40, 25)) < share
    plane, contacts = support_plane(GRID, heights, valid)
    expected = np.array([slow_twin(GRID, h, v) for h, v in zip(heights, valid, strict=True)])
    np.testing.assert_array_equal(plane.found, np.isfinite(expected))
    assert plane.found.mean() > 0.5
    f = plane.found
    at_center = plane.height[f] + plane.gradient[f] @ (NUDGE * np.ptp(GRID, axis=0))
    # Where several planes touch, their mean has the same height at the center, but not around it.
    np.testing.assert_allclose(at_center, expected[f], atol=1e-5)
    assert np.take_along_axis(valid[f], contacts[f], axis=1).all()


def test_over_an_edge_the_plane_is_the_mean_of_both_sides():
    roof = np.where(GRID[:, 0] < 0, 0.2, -0.4) * GRID[:, 0]
    roof[12] = -1.0  # nothing directly below the center
    both = np.ones((1, 25), dtype=bool)
    np.testing.assert_allclose(support_plane(GRID, roof[None], both)[0].gradient, [[-0.1, 0.0]], atol=1e-15)
    # Without ground beyond the edge there's only one side.
    one = (GRID[:, 0] >= 0)[None]
    np.testing.assert_allclose(support_plane(GRID, roof[None], one)[0].gradient, [[-0.4, 0.0]], atol=1e-15)


@pytest.mark.parametrize("n", [2, 3, 4, 9, 21])
@pytest.mark.parametrize("share", [1.0, 0.6])
def test_at_any_density_contacts_touch_surround_the_center_and_nothing_is_above(n, share):
    # By duality there's no lower plane then. Steps of 0.1 m give many ties.
    rng = np.random.default_rng(n)
    side = np.linspace(-1, 1, n)
    xy = np.stack(np.meshgrid(3.5 * side, 1.75 * side, indexing="ij"), -1).reshape(-1, 2)
    heights = np.round(rng.normal(0, 0.3, (300, n * n)) + xy @ [0.2, -0.1], 1) + 500.0
    valid = rng.random(heights.shape) < share
    plane, contacts = support_plane(xy, heights, valid)
    f = np.flatnonzero(plane.found)
    assert len(f) > (30 if n == 2 and share < 1 else 200)
    corners = xy[contacts[f]]
    ends = np.roll(corners, -1, axis=1)
    around = corners[..., 0] * ends[..., 1] - corners[..., 1] * ends[..., 0]
    assert (around > -1e-12).all()
    above = plane.height[f, None] + plane.gradient[f] @ xy.T - heights[f]
    sure = plane.margin[f] > 1e-9
    touching = np.take_along_axis(above, contacts[f], axis=1)
    np.testing.assert_allclose(touching[sure], 0, atol=1e-11)
    assert above[valid[f]].min() > -1e-11


def test_few_samples_and_no_rows_are_legal():
    assert support_plane(GRID, np.zeros((0, 25)), np.zeros((0, 25), bool))[0].found.shape == (0,)
    line = np.array([[-1.0, 0.0], [1.0, 0.0]])
    assert not support_plane(line, np.zeros((3, 2)), np.ones((3, 2), bool))[0].found.any()


def test_relief_below_the_smallest_divisor_is_flat():
    plane, _ = support_plane(GRID, 1e-308 * GRID[:, 0][None], np.ones((1, 25), dtype=bool))
    np.testing.assert_allclose(plane.gradient, [[0.0, 0.0]], atol=1e-300)
