"""Roles of a scenery's pieces by the config's patterns, name, material, and shape, without Blender."""

import numpy as np
import pytest

from hulldown.base.errors import AssetError
from hulldown.reading.build import build_scenery_and_wet_names
from hulldown.reading.doubts import scenery_doubts
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Evaluated, Piece, Unseen
from hulldown.reading.scenery.scenery_roles import matching_name_and_pattern, scenery_roles, unmatched_key_and_pattern
from hulldown.reading.vehicle_or_scenery import likely_kind, refuse_or_doubt_kind
from hulldown.tests.reading.test_roles import link, piece
from hulldown.tests.reading.test_roles import scenery_uses as uses

HILLS = piece("Plane.003", size=(200, 200, 12), level=0.98)
HOUSES = [piece(f"House.{i:03}", size=(9, 9, 6), at=(20 * i - 60, 30, 3), level=0.4) for i in range(7)]


def doubts_about(*pieces: Piece, size: tuple = (200.0, 200.0, 30.0)) -> tuple[Doubt, ...]:
    report = FileReport("scenery", "", size, 0, 1.0, "z")
    return scenery_doubts(report, pieces, scenery_roles(pieces, Options()), Options())


def lake(name: str, *, size: tuple = (60, 40, 0), level: float = 1.0, **more: object) -> Piece:
    return piece(name, size=size, level=level, **more)


@pytest.mark.parametrize(
    "name",
    [
        *("Water", "water.003", "WaterPlane", "waterplane", "Lake_surface", "lakeSurface", "River", "Ocean.001"),
        "pond-2",
        *("Wasser", "Wasserfläche", "See", "Fluss_1", "Teich", "lac", "eau", "rivière", "Agua", "río", "lago", "mare"),
        *("woda", "jezioro", "voda", "река", "озеро", "sjö", "水", "湖"),
    ],
)  # fmt: skip
def test_water_by_name_in_several_languages(name: str) -> None:
    assert uses(lake(name)) == ["water"]
    assert uses(lake("Plane", data=name)) == ["water"]
    assert uses(lake("Plane", materials=(name,))) == ["water"]
    assert uses(piece(link(name, "Terrain"), size=(60, 40, 0), level=1.0)) == ["water"]


@pytest.mark.parametrize(
    "dry",
    [
        *(lake("Lake_bed"), lake("Seashore"), lake("river bank"), lake("Water lily"), lake("Lake house")),
        lake("sea floor"),
        *(lake("Water", data="Terrain"), lake("More rocks"), lake("Snowflake"), lake("Driver"), lake("Watermelon")),
        lake("Water_tower", size=(6, 6, 5)),
        lake("Water", size=(2, 2, 9), level=0.2),
        lake("Waterfall", size=(20, 1, 30), level=0.0),
        lake("Puddle", size=(0.5, 0.5, 0)),
        piece(link("Plane", "Lake view"), size=(60, 40, 0), level=1.0),
    ],
    ids=lambda one: f"{one.name} {one.data} {one.chain[0].collections}",
)  # fmt: skip
def test_names_related_to_water_are_not_water(dry: Piece) -> None:
    assert uses(dry) != ["water"]


def test_water_by_material_is_wide_and_not_a_window() -> None:
    assert uses(lake("Plane.007", clear=True)) == ["water"]
    assert uses(lake("Plane.007", clear=True, scattered=True)) == ["water"]
    assert uses(lake("Skylight", size=(3, 3, 0), clear=True)) == ["obstacle"]
    assert uses(lake("Window", clear=True), lake("Plane", clear=True, materials=("Window glass",))) == ["obstacle"] * 2
    assert uses(lake("Pane", clear=True, level=0.0)) == ["obstacle"]


def test_water_that_is_only_a_volume_is_found_by_name() -> None:
    assert uses(lake("Ocean", unseen=Unseen.VOLUME, clear=True)) == ["water"]
    assert uses(lake("Mist", unseen=Unseen.VOLUME, clear=True)) == ["dropped"]
    assert uses(lake("Ocean", unseen=Unseen.HOLDOUT)) == ["dropped"]
    assert uses(lake("Mist", unseen=Unseen.VOLUME), water=("Mist",)) == ["water"]


def test_the_key_water_replaces_detection() -> None:
    pieces = [lake("Lake"), lake("Plane.001", at=(0, 0, 20)), lake("Plane.002", clear=True), piece("Terrain")]
    assert uses(*pieces) == ["water", "obstacle", "water", "ground"]
    assert uses(*pieces, water=("Plane.001",)) == ["obstacle", "water", "obstacle", "ground"]
    assert uses(*pieces, water=()) == ["obstacle", "obstacle", "obstacle", "ground"]


def test_a_flat_sheet_among_hills_is_water_by_shape_and_reported() -> None:
    terrain, sheet = piece("Terrain", size=(200, 200, 30), level=0.9), lake("Object_7", at=(0, 0, -5))
    assert uses(terrain, sheet) == ["ground", "water"]
    (doubt,) = doubts_about(terrain, sheet)
    assert doubt.kind == DoubtKind.WATER
    assert "'Object_7', by shape" in doubt.text
    for other in (lake("Object_7", at=(0, 0, 16)), lake("Object_7", size=(9, 9, 0)), lake("Object_7", size=(60, 40, 4))):
        assert uses(terrain, other) == ["ground", "obstacle"]
    assert uses(terrain, sheet, not_ground=("Object_7",)) == ["ground", "obstacle"]
    assert uses(terrain, sheet, water=()) == ["ground", "obstacle"]


def test_ground_with_a_water_material_is_a_doubt() -> None:
    terrain = piece("Terrain", size=(200, 200, 30), level=0.9, materials=("Grass", "Lake water"))
    assert any("'Terrain' is ground and wears 'Lake water'" in doubt.text for doubt in doubts_about(terrain))


@pytest.mark.parametrize(
    ("pieces", "expected"),
    [
        pytest.param([HILLS], ["ground"], id="alone"),
        pytest.param([piece("Lawn grass", size=(99, 99, 0.1), level=1.0), *HOUSES], ["Lawn grass"], id="name"),
        pytest.param(
            [piece(f"Tile.{i}", size=(50, 50, 3), at=(50 * (i % 3), 50 * (i // 3), 0), level=1.0) for i in range(9)],
            [f"Tile.{i}" for i in range(9)],
            id="tiles",
        ),
        pytest.param([HILLS, piece("Roof", size=(150, 150, 1), at=(0, 0, 30), level=1.0)], ["Plane.003"], id="a roof"),
        pytest.param([piece("Roof", size=(150, 150, 1), at=(0, 0, 30), level=1.0), *HOUSES], [], id="a roof alone"),
        pytest.param([piece("Dome", size=(900, 900, 450), level=0.13), HILLS, *HOUSES], ["Plane.003"], id="in a dome"),
        pytest.param(HOUSES, [], id="houses without ground"),
        pytest.param([piece("Cliffs", size=(200, 200, 90), level=0.3), *HOUSES], [], id="cliffs"),
        pytest.param([lake("Water", size=(200, 200, 0)), *HOUSES], [], id="water is no ground"),
    ],
)  # fmt: skip
def test_ground_by_shape_is_large_level_lowest_and_carries_other_objects(pieces: list[Piece], expected: list[str]) -> None:
    expected = ["Plane.003"] if expected == ["ground"] else expected
    for order in (pieces, pieces[::-1]):
        roles = scenery_roles(order, Options())
        assert sorted(p.name for p, role in zip(order, roles, strict=True) if role.use == "ground") == expected


PLAIN = piece("OuterGround", size=(2000, 2000, 0), at=(0, 0, -0.3), level=1.0)
ROAD = piece("Road", size=(110, 6, 0.1), at=(0, 0, 4.2), level=1.0)
WALLS = piece("Hall", size=(60, 60, 8), at=(0, 0, 3.7), level=0.0)
HORIZON_HOUSE = [piece("House", size=(12, 12, 9), at=(1500, 0, 10), level=0.4)]
FAN = piece("Fan", size=(4, 4, 2), at=(5, 5, 9), level=0.4)


@pytest.mark.parametrize(
    ("wide", "others", "use"),
    [
        (piece("GrassMesh", size=(120, 120, 4), at=(0, 0, 2), level=0.98), [ROAD], "ground"),
        (piece("q17", size=(120, 120, 4), at=(0, 0, 2), level=0.98), [ROAD], "ground"),
        (piece("Leaves.003", size=(120, 90, 4), at=(0, 0, 2), level=0.98), HOUSES[3:4], "ground"),
        (piece("moss", size=(1900, 1900, 8), level=0.9), [], "ground"),
        (piece("GrassMesh", size=(120, 120, 10), at=(0, 0, 4.8), level=0.4), [ROAD], "ground"),
        (piece("Hall_7", size=(120, 120, 10), at=(0, 0, 4.8), level=0.4, filled=2.0), [ROAD], "obstacle"),
        (piece("Grass", size=(120, 120, 0.8), at=(0, 0, 0.1), level=0.1), [ROAD], "obstacle"),
        (piece("Leaves", size=(120, 90, 4), at=(0, 0, 2), level=0.98), [], "obstacle"),
        (piece("Leaves", size=(120, 90, 4), at=(0, 0, 2), level=0.98, scattered=True), [ROAD], "obstacle"),
        (piece("Roof", size=(60, 60, 0.5), at=(0, 0, 8), level=0.98), [WALLS, FAN], "obstacle"),
        (piece("House_7", size=(60, 60, 8), at=(0, 0, 3.7), level=0.7, filled=2.0), [FAN], "obstacle"),
        (piece("Horizon", size=(900, 900, 130), at=(1500, 0, 60), level=0.9), HORIZON_HOUSE, "obstacle"),
        (piece("Canopy", size=(1900, 1900, 1), at=(0, 0, 40), level=0.98), [], "obstacle"),
    ],
)  # fmt: skip
def test_a_wide_mesh_under_roads_or_all_over_the_scenery_is_ground_by_any_name(
    wide: Piece, others: list[Piece], use: str
) -> None:
    assert uses(wide, PLAIN, *others)[0] == use
    assert uses(wide, PLAIN, *others, not_ground=(wide.name,))[0] == "obstacle"


def test_tiles_beside_roads_are_ground_by_any_name_and_roofs_are_not() -> None:
    road = piece("road", size=(90, 10, 0), level=1.0)
    for height, use in ((0.0, "ground"), (6.0, "obstacle")):
        grass = [piece("grass", size=(10, 10, 0), at=(10 * i - 40, 10, height), level=1.0) for i in range(9)]
        assert uses(road, *grass) == ["ground", *[use] * 9]


@pytest.mark.parametrize(("width", "doubted"), [(2000, True), (400, False)])
def test_a_town_in_a_corner_of_a_plain_is_a_doubt(width: float, doubted: bool) -> None:
    plain = piece("OuterGround", size=(width, width, 0), at=(0, 0, -0.3), level=1.0)
    texts = [doubt.text for doubt in doubts_about(plain, ROAD, HILLS, *HOUSES)]
    assert any('not_ground = ["OuterGround"]' in text for text in texts) is doubted


def test_ground_far_below_everything_is_a_doubt_with_the_ground() -> None:
    floor = piece("bottom_land", size=(2000, 2000, 0), at=(0, 0, -90), level=1.0)
    (doubt,) = [d for d in doubts_about(floor, HILLS, *HOUSES) if d.kind == DoubtKind.NOT_GROUND]
    assert 'ground = ["Plane.003"]' in doubt.text


def test_ground_far_below_everything_else_is_not_used() -> None:
    skirt = piece("Terrain_outer", size=(1200, 1200, 0), at=(0, 0, -200), level=1.0)
    track = piece("Track", size=(400, 400, 3), level=1.0)
    assert uses(skirt, track, *HOUSES)[:2] == ["obstacle", "ground"]
    assert uses(skirt, track, piece("House", size=(9, 9, 6), at=(500, 0, -197)))[:2] == ["ground", "ground"]
    doubts = doubts_about(skirt, track, *HOUSES)
    assert [(d.kind, "below everything else" in d.text) for d in doubts] == [(DoubtKind.NOT_GROUND, True)]


@pytest.mark.parametrize(("name", "height", "doubted"), [("Pine", 1.1, True), ("Pine", 9, False), ("Pine_log", 1, False)])
def test_a_world_of_toys_is_a_doubt_with_a_scale(name: str, height: float, doubted: bool) -> None:
    trees = [piece(f"{name}.{i:03}", size=(0.5, 0.5, height), at=(3 * i, 0, height / 2)) for i in range(9)]
    texts = [doubt.text for doubt in doubts_about(piece("Terrain", size=(64, 64, 1), level=1.0), *trees)]
    assert ["set scale = 10 (now 1)" in text for text in texts] == [True] * doubted


def test_houses_on_a_floor_are_not_a_vehicle() -> None:
    floor = piece("Object_1", size=(300, 300, 0.2), level=1.0)
    town = [piece(f"Object_{i + 2}", size=(12, 12, 9), at=(40 * i - 120, 0, 4.5), level=0.4) for i in range(7)]
    assert likely_kind([floor, *town], Options()) == "scenery"
    with pytest.raises(AssetError, match=r"it contains ground \('Object_1'\)"):
        refuse_or_doubt_kind("vehicle", [floor, *town], Options())
    tank = piece("Tank", size=(7, 3.5, 2.5), at=(0, 0, 1.4), level=0.4)
    assert likely_kind([floor, tank], Options()) == "vehicle"
    truck = [piece("Bed", size=(900, 250, 30), at=(0, 0, 100), level=0.9)]  # in centimeters
    truck += [piece(f"Object_{i}", size=(90, 30, 90), at=(300 * i - 300, 0, 45), level=0.2) for i in range(3)]
    assert likely_kind(truck, Options()) == "vehicle"


@pytest.mark.parametrize(
    ("pattern", "matches"),
    [
        ("Plane.003", True), ("plane.003", True), ("Plane", False), ("Plane.0030", False), ("Plane*", True),
        ("*.003", True),
        ("Terrain_mesh", False), ("mesh:Terrain_mesh", True), ("mesh:Plane.003", False), ("collection:Hills", True),
        ("material:grass*", True), ("Grass_A", False), ("Hills", False), ("nothing:Plane.003", False),
    ],
)  # fmt: skip
def test_a_pattern_matches_whole_object_names(pattern: str, matches: bool) -> None:
    one = piece(link("Plane.003", "Hills"), data="Terrain_mesh", materials=("Grass_A",))
    assert bool(matching_name_and_pattern(one, (pattern,))) is matches


def test_what_is_dropped_or_not_ground_precedes_ground() -> None:
    pieces = [piece("Plane"), piece("Plane.001"), piece("Terrain"), piece("Terrain.001")]
    assert uses(*pieces, ground=("Plane*",), not_ground=("Plane.001",)) == ["ground", "obstacle", "ground", "ground"]
    assert uses(*pieces, ground=("*",), drop=("Plane*",)) == ["removed", "removed", "ground", "ground"]


def test_geometry_by_nodes_is_not_ground_by_its_carriers_name() -> None:
    blades = piece("Plane.003", size=(9, 9, 1), scattered=True, anonymous=True, carrier="Plane.003")
    assert uses(HILLS, blades, ground=("Plane.003",)) == ["ground", "obstacle"]
    assert uses(HILLS, piece("Oak", scattered=True, carrier="Plane.003"), drop=("Plane.003",)) == ["removed"] * 2


def test_the_proposed_pattern_works_and_matches_nothing_else() -> None:
    slope = piece("Plane.003", size=(200, 200, 90), level=0.4)
    crate = piece("Crate", data="Plane.003", size=(2, 2, 2), at=(0, 0, 50))
    pieces = [slope, piece("Plane.004", size=(9, 9, 9)), crate]
    first, second = doubts_about(*pieces, size=(5.0, 5.0, 1.0))
    assert (first.kind, second.kind) == (DoubtKind.NO_GROUND, DoubtKind.SCALE)
    assert "if it is 'Plane.003', give this scenery ground = [\"Plane.003\"]" in first.text
    assert uses(*pieces, ground=("Plane.003",)) == ["ground", "obstacle", "obstacle"]


def test_a_dome_around_everything_is_a_doubt_with_a_drop_pattern() -> None:
    dome = piece("Sphere", size=(900, 900, 900), level=0.13)
    pieces = [dome, HILLS, *HOUSES]
    doubts = doubts_about(*pieces, size=(9e2, 9e2, 9e2))
    assert any(d.kind == DoubtKind.AROUND_ALL and 'drop = ["Sphere"]' in d.text for d in doubts)
    assert uses(*pieces, drop=("Sphere",))[0] == "removed"


@pytest.mark.parametrize("key", ["ground", "not_ground", "water", "drop"])
def test_a_pattern_that_matches_nothing_is_refused(key: str) -> None:
    with pytest.raises(AssetError, match=rf"{key} = 'Plane.03' matches nothing; it contains 'Plane.003'"):
        build_scenery_and_wet_names(
            "s", Evaluated(pieces=[HILLS]), [], meters=np.eye(4), options=Options(**{key: ("Plane.03",)})
        )


def test_only_drop_matches_the_carrier_of_a_piece():
    leaves = [piece("leaf", carrier="Emitter")]
    assert unmatched_key_and_pattern(leaves, Options(drop=("Emitter",))) is None
    assert unmatched_key_and_pattern(leaves, Options(ground=("Emitter",))) == ("ground", "Emitter")
