"""Paint: config, affected materials, random draws, and displays."""

from dataclasses import replace

import numpy as np
import pytest

from hulldown.planning.config.paint_section import PaintEntry, paint_doubts
from hulldown.planning.pictures.preview import caption
from hulldown.planning.pictures.shading import previewed
from hulldown.planning.plan.coats import Coat
from hulldown.planning.summary import summarize
from hulldown.planning.write import write_plan
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.pieces.paintable import MaterialRow, left_alone_by_name, painted
from hulldown.tests.planning_assets import DISTRACTOR_ENTRIES, VEHICLE_ENTRIES, small_assets, small_config

GREEN, SAND = "#4b5320", "#94835e"
GRAY = (0.2, 0.2, 0.2)
MATERIALS = [
    MaterialRow("Camo_Hull", 0.6, GRAY),
    MaterialRow("camo turret", 0.2, GRAY),
    MaterialRow("Canvas", 0.1, GRAY),
    MaterialRow("Tracks", 0.1, GRAY, "'track' is in its name"),
]


def config(paint, **sections):
    vehicles = [{**VEHICLE_ENTRIES[0], "paint": paint}, *VEHICLE_ENTRIES[1:]]
    others = [{**DISTRACTOR_ENTRIES[0], "paint": paint}, *DISTRACTOR_ENTRIES[1:]]
    return small_config(assets={"vehicles": vehicles, "distractors": others}, **sections)


def test_names_of_materials_that_are_left_alone_or_may_be_painted():
    alone = ["Tire", "TIRES", "rubber_black", "Track.001", "TrackLinks_L", "glass", "WindowGlass", "Headlight"]
    alone += ["decal_03"]
    able = ["Camouflage", "Track_Guard_Paint", "hull", "Tarpaulin", "Material.004", "lightning"]
    assert [name for name in alone + able if left_alone_by_name(name)] == alone


def test_a_material_gets_the_first_matching_coat():
    assert painted(MATERIALS, [["camo*"], ["*"]]) == {"Camo_Hull": 0, "camo turret": 0, "Canvas": 1}
    assert painted(MATERIALS, [["hull"], ["camo"]]) == {"Camo_Hull": 0, "camo turret": 1}
    assert painted(MATERIALS, [["track*"]]) == {}
    assert painted(MATERIALS, [["tracks"]]) == {"Tracks": 0}


def test_doubts_name_patterns_without_effect():
    def doubts(*materials):
        found = paint_doubts([PaintEntry(materials=(m,), colors=(GREEN,)) for m in materials], MATERIALS)
        assert {doubt.kind for doubt in found} <= {DoubtKind.PAINT}
        return [doubt.text for doubt in found]

    assert doubts("camo*", "canvas") == []
    assert doubts("camuflage") == [
        "paint: 'camuflage' matches no material; those that can be painted: 'Camo_Hull', 'camo turret', 'Canvas'"
    ]
    (alone,) = doubts("track*")
    assert "'Tracks' is left alone, 'track' is in its name; give its whole name" in alone
    assert doubts("*", "canvas") == ["paint: an earlier entry has all materials of ['canvas']"]


PAINT = [
    {"materials": ["camo*"], "colors": [GREEN, SAND, "#303030"], "value": [0.5, 1.5]},
    {"materials": ["canvas"], "hue_deg": [-20, 20]},
]


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
    assert len({first.value for first, _ in coats}) == len(coats)  # different random numbers for each
    assert all((second.color, second.saturation, second.value) == (None, 1.0, 1.0) for _, second in coats)


def test_vehicles_without_materials_have_no_coats(assets, tmp_path):
    bare = replace(assets, without_material=frozenset({"car"}))
    wanted = config(PAINT, placement={"distractors_per_image": 2}, budget={"images_per_class": 4})
    rows = list(write_plan(wanted, bare, tmp_path / "plan.jsonl"))
    coats = {name: [len(v.paint) for row in rows for v in row.planned if v.vehicle == name] for name in ("car", "t72")}
    assert set(coats["car"]) == {0}
    assert set(coats["t72"]) == {2}


def test_the_summary_counts_coats(made):
    counts = summarize(made).counts["paints"]
    rows = list(made)
    coats = [coat for row in rows for vehicle in row.vehicles for coat in vehicle.paint]
    assert counts.total() == len(coats)
    assert counts["own"] == len(coats) / 2
    assert summarize(made).to_json()["paints"] == dict(counts)


def test_a_preview_has_the_first_coats_color(made):
    own = np.array([0.3, 0.4, 0.2])
    assert np.array_equal(previewed(own, []), own)
    assert previewed(own, [Coat(["*"], "#ff0000")]) == pytest.approx([1.0, 0.0, 0.0])
    assert previewed(own, [Coat(["*"], None, 0.0, 0.0, 0.5)]) == pytest.approx([0.2, 0.2, 0.2])
    assert previewed(own, [Coat(["*"], None, 120.0)]) == pytest.approx([0.2, 0.3, 0.4])
    row = next(row for row in made if row.target.paint and not row.empty)
    assert f"{row.target.vehicle}, {row.target.paint[0].color} in {row.scenery}" in caption(row)
