"""Rest planes by both rules, compared with general solvers."""

import numpy as np
import pytest
from scipy.optimize import linprog

from hulldown.placement.footprint import Samples
from hulldown.placement.rest import PLANE_NUDGE, fit_averaged_planes, fit_support_planes, fit_underside_planes

SAMPLES = np.stack(np.meshgrid(np.linspace(-3, 4, 5), np.linspace(-1.5, 2, 4), indexing="ij"), -1).reshape(-1, 2)
PLATE = Samples(SAMPLES, np.zeros(20), np.ones(20, dtype=bool), np.array([0.5, 0.25]))


def grid(n):
    side = np.linspace(-1, 1, n)
    return np.stack(np.meshgrid(3.5 * side, 1.75 * side, indexing="ij"), -1).reshape(-1, 2)


def test_averages_use_only_valid_hits():
    rng = np.random.default_rng(1)
    normals = np.concatenate([rng.normal(0, 0.5, (30, 20, 2)), np.ones((30, 20, 1))], axis=2)
    valid = rng.random((30, 20)) < 0.7
    heights = np.where(valid, rng.normal(40, 1, (30, 20)), np.nan)
    normals = np.where(valid[..., None], normals / np.linalg.norm(normals, axis=2, keepdims=True), np.nan)
    mean = fit_averaged_planes(SAMPLES, heights, normals, valid)
    assert mean.found.all()
    for i, seen in enumerate(valid):
        x, y, up = normals[i, seen].mean(axis=0)
        np.testing.assert_allclose(mean.gradient[i], [-x / up, -y / up], atol=1e-13)
        at_middle = mean.height[i] + mean.gradient[i] @ SAMPLES[seen].mean(axis=0)
        np.testing.assert_allclose(at_middle, heights[i, seen].mean(), atol=1e-12)


def test_hits_on_one_line_or_none_give_no_plane():
    heights, normals = np.zeros((3, 20)), np.tile([0.0, 0.0, 1.0], (3, 20, 1))
    valid = np.array([np.zeros(20, bool), np.arange(20) < 4, np.arange(20) == 7])
    assert fit_underside_planes(PLATE, heights, valid).found.tolist() == [False] * 3
    assert fit_averaged_planes(SAMPLES, heights, normals, valid).found.tolist() == [False, True, True]


def test_over_an_edge_the_support_plane_is_the_mean_of_both_sides():
    samples = grid(5)
    roof = np.where(samples[:, 0] < 0, 0.2, -0.4) * samples[:, 0]
    roof[12] = -1.0  # nothing directly below the center
    # Without ground beyond the edge there's only one side.
    for valid, slope in ((np.ones((1, 25), dtype=bool), -0.1), ((samples[:, 0] >= 0)[None], -0.4)):
        np.testing.assert_allclose(fit_support_planes(samples, roof[None], valid).gradient, [[slope, 0.0]], atol=1e-15)
    flat = fit_support_planes(samples, 1e-308 * samples[:, 0][None], np.ones((1, 25), dtype=bool))
    np.testing.assert_allclose(flat.gradient, [[0.0, 0.0]], atol=1e-300)


@pytest.mark.parametrize("n", [2, 3, 4, 5, 9])
@pytest.mark.parametrize("share", [1.0, 0.6])
def test_no_plane_on_or_above_all_samples_is_lower_at_the_center_than_the_support_plane(n, share):
    rng, xy = np.random.default_rng(n), grid(n)
    # Steps of 0.1 m give many ties.
    heights = np.round(rng.normal(0, 0.3, (100, n * n)) + xy @ [0.2, -0.1], 1) + 500.0
    valid = rng.random(heights.shape) < share
    plane, center = fit_support_planes(xy, heights, valid), PLANE_NUDGE * np.ptp(xy, axis=0)
    above = plane.height[:, None] + plane.gradient @ xy.T - heights
    assert above[valid & plane.found[:, None]].min() > -1e-11
    assert plane.found.sum() > (10 if n == 2 and share < 1 else 60)
    for i, seen in enumerate(valid):
        # Unbounded if the center is outside the hull of the samples.
        lowest = linprog([1.0, *center], -np.c_[np.ones(n * n), xy][seen], 500.0 - heights[i, seen], bounds=(None, None))
        assert plane.found[i] == (lowest.status == 0)
        if plane.found[i]:
            at_center = plane.height[i] + plane.gradient[i] @ center
            assert at_center == pytest.approx(500.0 + lowest.fun, abs=1e-5)
