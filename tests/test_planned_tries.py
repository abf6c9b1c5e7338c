"""The tries of a position depend on that position alone, and are counted exactly."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hulldown.geometry.errors import ConfigError
from hulldown.planning.planner import Planner
from hulldown.planning.row import encode_rows
from hulldown.tests.planning_assets import hills, small_assets, small_config

POSITIONS = 16
ASSETS = replace(small_assets(), sceneries={"hills": hills("hills", cells=20, trees=3)})
CUTS = [(1, 8192), (5, 16), (POSITIONS, 16), (POSITIONS, 8192)]  # positions per block, tries per batch


@cache
def planner_of(max_tries, *, slope_deg=2.5, blind_below_px=None):
    """A world with few level places, all of them visible."""
    camera = {"min_box_px": blind_below_px, "max_tries": 1} if blind_below_px else {}
    config = small_config(
        assets={"sceneries": [{"path": "hills.blend"}]},
        budget={"images_per_class": POSITIONS // 2, "images_per_position": 1},
        camera={"visibility_rays": 4, **camera},
        placement={"max_slope_deg": slope_deg, "max_tries": max_tries},
    )
    return Planner(config, ASSETS)


def rows_in_blocks(planner, size):
    blocks = range(0, POSITIONS, size)
    return [row for start in blocks for row in planner.rows(start, min(start + size, POSITIONS))]


@pytest.fixture(scope="module")
def rows():
    return planner_of(10_000).rows(0, POSITIONS)


@pytest.mark.parametrize(("size", "candidates"), CUTS)
def test_the_same_position_fails_however_the_work_is_cut(rows, size, candidates, monkeypatch):
    monkeypatch.setattr("hulldown.planning.search.positions.CANDIDATES", candidates)
    monkeypatch.setattr("hulldown.planning.search.positions.SCOUTS", 2)
    tries = [row.target.tries for row in rows]
    assert max(tries) > 20
    limit = int(np.median(tries))
    first = next(row for row in rows if row.target.tries > limit)
    message = rf"^position {first.position}: vehicle '{first.target.vehicle}' .* of {limit} tries"
    with pytest.raises(ConfigError, match=message):
        rows_in_blocks(planner_of(limit), size)


@pytest.mark.parametrize("limit", [1, 2, 3, 5])
def test_no_position_is_tried_more_often_than_allowed(rows, limit):
    # max_tries = 2 gave rows with 3 tries.
    planner = planner_of(limit)
    for row in rows[:8]:
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
