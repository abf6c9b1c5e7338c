"""What a scenery shows from above, and floors far below it, without Blender."""

import numpy as np
import pytest

from hulldown.assets.scenery import Scenery
from hulldown.geometry.meshes import merge_meshes_with_sources
from hulldown.reading.inspect import draw_asset
from hulldown.reading.scenery.shape import level_share_and_area
from hulldown.reading.scenery.top_view import top_view_and_doubts
from hulldown.tests.builders.shapes import surface
from hulldown.tests.reading.test_build import box

FLAT = np.zeros((3, 3))


def plane(width, z):
    x = np.linspace(-width / 2, width / 2, 3)
    return surface(x, x, FLAT + z)


@pytest.mark.parametrize(("depth", "doubted"), [(200.0, True), (20.0, False)])
def test_shares_and_a_floor_far_below_everything(depth, doubted):
    ground, _ = merge_meshes_with_sources([plane(100, 0), plane(200, -depth)])
    house, pond = box([50, 50, 8], [0, 0, 4]), plane(20, 1)
    places = np.tile(np.eye(4), (2, 1, 1))
    places[1, :2, 3] = 40, 40
    scenery = Scenery(
        "map", np.zeros(3), ground, ("map",), (house, pond), np.arange(2), places, ("house", "pond"),
        np.zeros(2, bool), np.array([False, True]), np.eye(4),
    )  # fmt: skip
    view, doubts = top_view_and_doubts(scenery)
    picture = np.asarray(draw_asset(scenery, size=120)).astype(int)
    assert (picture[..., 2] - picture[..., 0] > 100).any(), "water is blue"
    assert (view.obstacle, view.water, view.nothing) == pytest.approx((1 / 16, 1 / 100, 0), abs=2e-3)
    assert view.ground + view.obstacle + view.water == pytest.approx(1.0, abs=1e-3)
    assert ["75 % of the ground is 200 m below" in doubt.text for doubt in doubts] == [True] * doubted


def test_a_closed_mesh_fills_its_bounds_twice():
    assert level_share_and_area(box([4, 4, 1], [0, 0, 0]), np.eye(4))[1] == pytest.approx(32)
    hill = surface(np.linspace(-2, 2, 3), np.linspace(-2, 2, 3), np.array([[0, 3, 0]] * 3))
    assert level_share_and_area(hill, np.eye(4)) == pytest.approx((0.0, 16.0))
