"""The tries of a position depend on that position alone, and are counted exactly."""

from functools import cache

import pytest

from hulldown.geometry.errors import ConfigError
from hulldown.planning.planner import Planner
from hulldown.planning.row import encode_rows
from hulldown.tests.planning_assets import hills, small_assets, small_config

ASSETS = small_assets(hills("hills", cells=20, trees=3))


@cache
def planner_of(max_tries, *, slope_deg=2.5, blind_below_px=None):
    """A world with few level places, all of them visible."""
    camera = {"min_box_px": blind_below_px, "max_tries": 1} if blind_below_px else {}
    config = small_config(
        budget={"images_per_class": 8, "images_per_position": 1},
        camera={"visibility_rays": 4, **camera},
        placement={"max_slope_deg": slope_deg, "max_tries": max_tries},
    )
    return Planner(config, ASSETS)


@pytest.mark.parametrize("limit", [1, 2, 3, 5])
def test_no_position_is_tried_more_often_than_allowed(limit):
    # max_tries = 2 gave rows with 3 tries.
    planner = planner_of(limit)
    for row in planner_of(10_000).rows(0, 8):
        position = row.position
        if row.target.tries <= limit:
            assert encode_rows(planner.rows(position, position + 1)) == encode_rows([row])
        else:
            with pytest.raises(ConfigError, match=f"of {limit} tries"):
                planner.rows(position, position + 1)


def test_places_without_a_view_count_as_tries():
    # A position that no camera sees is moved, and its tries count on.
    with pytest.raises(ConfigError, match=r"finds no place to stand: of 6 tries .*could not be seen by any camera"):
        planner_of(6, slope_deg=40.0, blind_below_px=700).rows(0, 1)
    seldom = planner_of(30, slope_deg=40.0, blind_below_px=100)
    assert all(row.target.tries <= 30 for row in seldom.rows(0, 8))
