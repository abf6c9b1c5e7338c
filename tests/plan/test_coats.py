"""Paint: config, painted materials, random draws, and displays."""

import numpy as np
import pytest

from hulldown.plan.coats import Coat, color_of_material
from hulldown.plan.config.asset_sections import PaintEntry
from hulldown.plan.library import unmatched_paint_pattern
from hulldown.plan.pictures.preview import image_caption
from hulldown.plan.pictures.shading import coat_or_own_color
from hulldown.plan.summary import summarize_plan
from hulldown.planning.write import write_plan
from hulldown.reading.pieces.asset_report import MaterialRow
from hulldown.tests.builders.planning_assets import DISTRACTOR_ENTRIES, VEHICLE_ENTRIES, small_assets, small_config

GREEN, SAND = "#4b5320", "#94835e"


def config(paint, **sections):
    vehicles = [{**VEHICLE_ENTRIES[0], "paint": paint}, *VEHICLE_ENTRIES[1:]]
    others = [{**DISTRACTOR_ENTRIES[0], "paint": paint}, *DISTRACTOR_ENTRIES[1:]]
    return small_config(assets={"vehicles": vehicles, "distractors": others}, **sections)


@pytest.mark.parametrize(
    ("name", "color"),
    [("Camo_Hull", GREEN), ("camo turret", GREEN), ("Canvas", SAND), ("Tracks", None), ("Mesh [1]", SAND), ("M", None)],
)
def test_only_a_named_material_is_painted_by_the_first_matching_coat(name, color):
    coats = [Coat(["camo*"], GREEN), Coat(["m"], None), Coat(["canvas", "camo*", "mesh [1]", "m"], SAND)]
    assert color_of_material(name, coats) == color


def test_a_pattern_that_matches_no_material_is_found():
    def unmatched(*materials):
        rows = [MaterialRow("Camo_Hull", 0.6), MaterialRow("Canvas", 0.4)]
        return unmatched_paint_pattern([PaintEntry(materials=(m,), colors=(GREEN,)) for m in materials], rows)

    assert unmatched("camo*", "canvas") is None
    assert unmatched("camo*", "camuflage", "canvas") == "camuflage"


PAINT = [{"materials": ["camo*"], "colors": [GREEN, SAND, "#303030"]}, {"materials": ["canvas"], "colors": ["own"]}]


@pytest.fixture(scope="module")
def assets():
    return small_assets(distractors=True)


@pytest.fixture(scope="module")
def made(assets, tmp_path_factory):
    wanted = config(
        PAINT,
        seed=2,
        budget={"images_per_class": 6, "images_per_position": 2, "background_share": 0.2},
        placement={"vehicles_per_image": [1, 3], "distractors_per_image": 2, "companion_distance": [9, 30]},
        camera={"visibility_rays": 4},
    )
    return write_plan(wanted, assets, tmp_path_factory.mktemp("paint") / "plan.jsonl")


def test_each_vehicle_of_a_position_has_its_own_coats(made):
    by_position = {}
    for row in made:
        for k, vehicle in enumerate(row.planned):
            assert len(vehicle.paint) == (2 if vehicle.vehicle in ("t72", "car") else 0)
            by_position.setdefault((row.position, k, vehicle.vehicle), []).append(vehicle.paint)
    coats = [paints[0] for paints in by_position.values() if paints[0]]
    assert all(paints == paints[:1] * len(paints) for paints in by_position.values())
    assert {first.color for first, _ in coats} == {GREEN, SAND, "#303030"}
    assert {second.color for _, second in coats} == {None}
    beside = [[v.paint[0].color for v in row.planned if v.vehicle == "t72"] for row in made]
    assert any(len(set(colors)) > 1 for colors in beside), "vehicles in one picture have colors of their own"


def test_the_summary_counts_coats(made):
    counts = summarize_plan(made).counts["paints"]
    rows = list(made)
    coats = [coat for row in rows for vehicle in row.vehicles for coat in vehicle.paint]
    assert counts.total() == len(coats)
    assert counts["own"] == len(coats) / 2
    assert summarize_plan(made).to_json()["paints"] == dict(counts)


def test_a_preview_has_the_first_coats_color(made):
    own = np.array([0.3, 0.4, 0.2])
    assert np.array_equal(coat_or_own_color(own, []), own)
    assert coat_or_own_color(own, [Coat(["*"], "#ff0000")]) == pytest.approx([1.0, 0.0, 0.0])
    assert np.array_equal(coat_or_own_color(own, [Coat(["*"], None)]), own)
    row = next(row for row in made if row.target.paint and not row.hides_target)
    assert f"{row.target.vehicle}, {row.target.paint[0].color} in {row.scenery}" in image_caption(row)
