"""Vehicles that find no place in a scenery are left out and reported; the plan continues."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from hulldown.base.errors import ConfigError
from hulldown.plan.plan_file import read_plan
from hulldown.plan.row import encode_rows
from hulldown.plan.summary import summarize_plan
from hulldown.planning.check import check_plan
from hulldown.planning.planner import Planner
from hulldown.planning.search.random_streams import Purpose, choose_weighted_indices
from hulldown.planning.write import write_plan
from hulldown.tests.builders.planning_assets import hills, plan, small_assets, small_config, vehicle

BASE = small_assets()
HILLS, BARE = BASE.sceneries.values()
CLIFFS = hills("cliffs", height=400.0, trees=0)  # steeper than 30 degrees almost everywhere
YARD = hills("yard", size=7.0, trees=0)


def test_pairs_without_a_place_are_left_out_and_classes_stay_balanced(tmp_path):
    # Somebody's files: one scenery had no place for one vehicle, which failed the plan of nine.
    assets = small_assets(*BASE.sceneries.values(), YARD)
    made = write_plan(small_config(budget={"images_per_class": 24}), assets, tmp_path / "plan.jsonl")
    assert {(pair.vehicle, pair.scenery) for pair in made.header.left_out} == {(v, "yard") for v in BASE.vehicles}
    assert all("vehicles are placed within 5.6 x 5.6 m" in pair.why for pair in made.header.left_out)
    rows = list(made)
    assert Counter(row.target.category for row in rows) == {"tank": 24, "truck": 24}
    assert {row.scenery for row in rows} == {"hills", "bare"}
    assert check_plan(made, assets) == []
    notes = summarize_plan(made, left_out=made.header.left_out).unmet_wish_notes()
    assert len(notes) == 3
    assert "'leo' is 9.24 m long; in 'yard'" in notes[1]


def test_a_pair_is_left_out_after_trial_placements():
    assets = small_assets(BARE, CLIFFS)
    config = small_config(placement={"max_slope_deg": 0.01, "max_tries": 100})
    planner = Planner(config, assets)
    assert [pair.scenery for pair in planner.pairs.left_out] == ["cliffs"] * 3
    assert "finds no place to stand: of 100 tries" in planner.pairs.left_out[0].why
    assert {row.scenery for row in plan(config, assets)} == {"bare"}


def test_a_vehicle_without_any_scenery_is_an_error_and_so_is_a_missing_pair_if_strict():
    with pytest.raises(ConfigError, match=r"'t72' is 8.4 m long; in 'yard' .*; look at both"):
        Planner(small_config(), small_assets(YARD))
    with pytest.raises(ConfigError, match="in 'yard' vehicles are placed"):
        Planner(small_config(), small_assets(BARE, YARD), strict=True)


def test_a_vehicle_without_images_needs_no_scenery():
    assets = small_assets(HILLS)
    assets = replace(assets, vehicles={**assets.vehicles, "ural": vehicle("ural", 25.0)})
    config = small_config(budget={"images_per_class": {"tank": 4, "truck": 0}})
    assert len(list(plan(config, assets))) == 4


def test_a_position_without_a_place_moves_to_another_scenery_for_any_worker(tmp_path, monkeypatch):
    monkeypatch.setattr("hulldown.planning.write._MIN_BLOCK_POSITIONS", 5)
    # Half of the positions on these hills have no place.
    assets = small_assets(hills("hills", cells=20, trees=3), BARE)
    config = small_config(
        budget={"images_per_class": 8, "images_per_position": 1},
        camera={"visibility_rays": 4},
        placement={"max_slope_deg": 2.5, "max_tries": 12},
    )
    made = [write_plan(config, assets, tmp_path / f"{n}.jsonl", workers=n).path.read_bytes() for n in (1, 3)]
    assert made[0] == made[1]
    rows = list(read_plan(tmp_path / "1.jsonl"))
    planner = Planner(config, assets)
    assert not planner.pairs.left_out
    in_two = planner.rows(0, 3) + planner.rows(3, len(rows))
    assert encode_rows(in_two) == encode_rows(rows)
    uniform = planner._draws.uniform(Purpose.SCENERY, np.arange(len(rows)), 0, count=1)[:, 0]
    drawn = choose_weighted_indices(planner.pairs.weights[planner.budget.positions.vehicle], uniform)
    moved = [row for row, site in zip(rows, drawn.tolist(), strict=True) if row.scenery != ("hills", "bare")[site]]
    assert len(moved) > 1
    assert {row.scenery for row in moved} == {"bare"}
    assert check_plan(read_plan(tmp_path / "1.jsonl"), assets) == []
    with pytest.raises(ConfigError, match=r"^position \d+: vehicle .* finds no place to stand"):
        Planner(config, assets, strict=True).rows(0, len(rows))


def test_a_vehicle_is_planned_only_on_its_sceneries(tmp_path):
    patterns = {"t72": ["h*"], "leo": [], "ural": ["bare"]}
    vehicles = [{"path": f"{name}.blend", "category": BASE.categories[name], "sceneries": on} for name, on in patterns.items()]
    config = small_config(
        assets={"vehicles": vehicles},
        budget={"images_per_class": 24, "images_per_position": 2},
        placement={"vehicles_per_image": [1, 3]},
    )
    made = write_plan(config, BASE, tmp_path / "plan.jsonl")
    on = {name: {row.scenery for row in made for one in row.vehicles if one.vehicle == name} for name in BASE.vehicles}
    assert on == {"t72": {"hills"}, "ural": {"bare"}, "leo": {"hills", "bare"}}
    assert made.header.left_out == []
    assert check_plan(made, BASE) == []


@pytest.mark.parametrize(
    ("sceneries", "weight", "message"),
    [
        (["hils"], 1.0, "sceneries of 't72': 'hils' matches no scenery; sceneries are hills, bare"),
        (["bare"], 0.0, "'t72' has no scenery: those that it is for have weight 0"),
    ],
)
def test_impossible_sceneries_of_a_vehicle_are_refused(sceneries, weight, message):
    vehicles = [{"path": "t72.blend", "category": "tank", "sceneries": sceneries}]
    files = {"vehicles": vehicles, "sceneries": [{"path": "hills.blend"}, {"path": "bare.blend", "weight": weight}]}
    with pytest.raises(ConfigError, match=message):
        Planner(small_config(assets=files), small_assets(vehicles=["t72"]))


def crowded(**placement):
    """A config of several companions near each target."""
    return small_config(
        budget={"images_per_class": 2, "images_per_position": 2},
        camera={"visibility_rays": 4, "visible_fraction": [0, 1]},
        placement={"vehicles_per_image": 4, **placement},
    )


def test_companions_without_room_are_left_out_and_counted(tmp_path, monkeypatch):
    # It ended the plan, with advice that led to the same error.
    monkeypatch.setattr("hulldown.planning.search.positions.MAX_PLACES_WITHOUT_ROOM", 0)
    assets = small_assets(BARE)
    made = write_plan(crowded(companion_distance=[6, 6.5]), assets, tmp_path / "plan.jsonl")
    rows = list(made)
    assert all(row.left_out + len(row.companions) == 3 for row in rows)
    assert any(row.left_out for row in rows)
    assert any(row.companions for row in rows)
    assert check_plan(made, assets) == []
    left_out = sum(row.left_out for row in rows if row.shot == 0)
    summary = summarize_plan(made)
    assert summary.unmet_wish_notes() == [f"left out: {left_out} companions and distractors without room at their position"]
    assert summary.to_json()["companions_left_out"] == left_out


def test_few_tries_drop_companions_before_the_position():
    assert all(row.left_out for row in plan(crowded(companion_distance=[5, 6], max_tries=2), small_assets(BARE)))
