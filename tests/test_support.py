import numpy as np
import pytest
import shapely

from hulldown.placement.support import NUDGE, support_plane

GRID = np.stack(np.meshgrid(np.linspace(-3.5, 3.5, 5), np.linspace(-1.75, 1.75, 5), indexing="ij"), -1).reshape(-1, 2)


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
    center = NUDGE * np.ptp(xy, axis=0)
    around = [shapely.convex_hull(shapely.multipoints(xy[v])) for v in valid]
    np.testing.assert_array_equal(plane.found, shapely.contains_xy(around, *center))
    f = np.flatnonzero(plane.found)
    assert len(f) > (30 if n == 2 and share < 1 else 200)
    assert np.take_along_axis(valid[f], contacts[f], axis=1).all()
    corners = xy[contacts[f]]
    ends = np.roll(corners, -1, axis=1)
    around = corners[..., 0] * ends[..., 1] - corners[..., 1] * ends[..., 0]
    assert (around > -1e-12).all()
    above = plane.height[f, None] + plane.gradient[f] @ xy.T - heights[f]
    sure = plane.margin[f] > 1e-9
    touching = np.take_along_axis(above, contacts[f], axis=1)
    np.testing.assert_allclose(touching[sure], 0, atol=1e-11)
    # Where several planes touch, their mean has the height of each at the center, but not around it.
    system = np.concatenate([np.swapaxes(corners, 1, 2), np.ones((len(f), 1, 3))], axis=1)
    weights = np.linalg.solve(system, np.append(center, 1.0)[None, :, None])[..., 0]
    np.testing.assert_allclose((weights * touching).sum(axis=1), 0, atol=1e-5)
    assert above[valid[f]].min() > -1e-11


def test_relief_below_the_smallest_divisor_is_flat():
    plane, _ = support_plane(GRID, 1e-308 * GRID[:, 0][None], np.ones((1, 25), dtype=bool))
    np.testing.assert_allclose(plane.gradient, [[0.0, 0.0]], atol=1e-300)
