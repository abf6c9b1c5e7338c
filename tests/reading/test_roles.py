"""Names, roles, and parts, without Blender."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from hulldown.base.errors import AssetError
from hulldown.reading.doubts import vehicle_doubts
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.pieces.naming import (
    GROUND_WORDS,
    GUN_HINTS,
    GUN_WORDS,
    HELPER_WORDS,
    TURRET_HINTS,
    first_matching_pattern,
    first_matching_stem,
)
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Link, Piece, Unseen, vehicle_roles
from hulldown.reading.scenery.scenery_roles import scenery_roles
from hulldown.reading.vehicle.parts import Parts, find_parts
from hulldown.reading.vehicle.solids import PlacedPieces, find_solids
from hulldown.reading.vehicle_or_scenery import likely_kind, refuse_or_doubt_kind


def link(name: str, *collections: str, kind: str = "MESH", at: tuple = (0.0, 0.0, 0.0)) -> Link:
    pose = np.eye(4)
    pose[:3, 3] = at
    return Link(name, collections, kind, pose)


def piece(*chain: Link | str, size: tuple = (1, 1, 1), at: tuple = (0, 0, 0), data: str = "Mesh", **more: object) -> Piece:
    links = tuple(link(c) if isinstance(c, str) else c for c in chain)
    half = np.array(size, float) / 2
    bounds = np.array([np.subtract(at, half), np.add(at, half)])
    return Piece(data, links, 0, np.eye(4), bounds, 12, **more)


def vehicle_uses(*pieces: Piece, **options: object) -> list[str]:
    return [role.use for role in vehicle_roles(pieces, **options)]


def scenery_uses(*pieces: Piece, **options: object) -> list[str]:
    return [role.use for role in scenery_roles(pieces, Options(**options))]


HULL = piece("Hull", size=(6, 3, 1), at=(0, 0, 1))


@pytest.mark.parametrize(
    ("match", "name", "words", "found"),
    [
        (first_matching_pattern, "groundhog", GROUND_WORDS, False),
        (first_matching_pattern, "playGROUND", GROUND_WORDS, True),
        (first_matching_pattern, "GROUNDS.012", GROUND_WORDS, True),
        (first_matching_pattern, "shadowcatcher", HELPER_WORDS, True),
        (first_matching_pattern, "Shadow-Catcher.001", HELPER_WORDS, True),
        (first_matching_pattern, "Gunner_Sight", GUN_WORDS, False),
        (first_matching_pattern, "gunShip", GUN_WORDS, True),
        (first_matching_pattern, "Main_Gun.003", GUN_WORDS, True),
        (first_matching_pattern, "TerrainFar", ["terrain*"], True),
        (first_matching_pattern, "FarTerrain", ["terrain*"], False),
        (first_matching_pattern, "Tile[3]", ["tile[[]3]"], True),
        (first_matching_pattern, "anything", ["", "..."], False),
        # Words inside words and in other languages.
        (first_matching_stem, "gunbarrel", GUN_HINTS, True),
        (first_matching_stem, "guncariage_2", GUN_HINTS, True),
        (first_matching_stem, "turretpivot", TURRET_HINTS, True),
        (first_matching_stem, "Turm_03", TURRET_HINTS, True),
        (first_matching_stem, "Geschütz", GUN_HINTS, True),
        (first_matching_stem, "turet", TURRET_HINTS, True),
        (first_matching_stem, "BASHNYA01", TURRET_HINTS, True),
        (first_matching_stem, "炮塔", TURRET_HINTS, True),
        (first_matching_stem, "begonia", GUN_HINTS, False),
        (first_matching_stem, "Sturmhaube", TURRET_HINTS, False),
        (first_matching_stem, "vezel", ("wheel",), False),
        (first_matching_stem, "pieza_11", TURRET_HINTS, False),
    ],
)
def test_names_match_words(match: Callable, name: str, words: Sequence[str], found: bool) -> None:
    assert bool(match(name, words)) is found


@pytest.mark.parametrize(
    ("thing", "use"),
    [
        (piece("UCX_Hull"), "dropped"),
        (piece("box", link("Collision", kind="EMPTY")), "dropped"),
        *[(piece(n, size=(20, 20, 1.5)), "dropped") for n in ("Plane", "Grid.001", "Plane_Plane.002")],
        (piece("Floor", size=(20, 20, 0.1)), "dropped"),
        (piece("Floor", size=(2, 2, 0.02), at=(0, 0, 0.49)), "dropped"),
        (piece("Cabin_Floor", size=(2, 2, 0.1), at=(0, 0, 1.2)), "vehicle"),
        (piece("Plane.004", size=(0.02, 2, 1), at=(3, 0, 1)), "vehicle"),
        (piece("x", data="Ground", size=(20, 20, 0.1)), "dropped"),
        (piece("Object_17", size=(30, 30, 0)), "dropped"),
        (piece("Roof", size=(30, 30, 0), at=(0, 0, 9)), "vehicle"),
        (piece("Skirt", size=(7, 4, 0.01), at=(0, 0, 0.5)), "vehicle"),
        (piece("blob_shadow", size=(8, 4, 0.01), at=(0, 0, 0.5)), "dropped"),
        (piece("Light bar", size=(0.2, 2, 0.2), at=(0, 0, 2)), "vehicle"),
    ],
)
def test_helpers_are_found_by_name_and_stages_and_sheets_by_position(thing: Piece, use: str) -> None:
    for pieces in ((HULL, thing), (thing, HULL)):
        assert vehicle_uses(*pieces)[pieces.index(thing)] == use


def test_a_body_modeled_from_a_plane_is_the_vehicle() -> None:
    """Exporters write "truck_Plane", and a mesh that began as a plane keeps the name "Plane"."""
    wheels = piece("wheels", size=(4, 2, 0.8), at=(0, 0, 0.4))
    for body in (
        piece("car_shell", data="Plane", size=(6, 2, 1.4), at=(0, 0, 1)),
        piece("truck_Plane", size=(6, 2, 2.7), at=(0, 0, 1.5)),
        piece("roof_Plane.003", size=(6, 2, 0.1), at=(0, 0, 3)),
        piece("Plane", size=(6, 2, 1.4), at=(0, 0, 1)),
        piece(link("body", "plane"), size=(6, 2, 1.4), at=(0, 0, 1)),
    ):
        assert vehicle_uses(wheels, body) == ["vehicle", "vehicle"]


def test_the_config_overrides_the_rules_and_keep_overrides_drop() -> None:
    floor, wheel, spare = piece("Floor", size=(20, 20, 0.1)), piece("Wheel"), piece("Wheel_spare")
    got = vehicle_uses(HULL, floor, wheel, spare, keep=["floor", "*spare"], drop=["wheel*"])
    assert got == ["vehicle", "vehicle", "dropped", "vehicle"]
    unseen = piece("Ghost", unseen=Unseen.RAY_VISIBILITY)
    assert vehicle_uses(HULL, unseen, keep=["*"]) == ["vehicle", "dropped"]


@pytest.mark.parametrize(
    ("thing", "use"),
    [
        (piece("Ground.001"), "ground"),
        (piece("Cube", data="terrain_mesh"), "ground"),
        (piece(link("Cube", "Roads")), "ground"),
        (piece(link("Rock_03", "Ground")), "obstacle"),
        (piece("Ground_cover"), "obstacle"),
        (piece("Road_sign"), "obstacle"),
        (piece("Cube"), "obstacle"),
        (piece("Skydome"), "backdrop"),
        (piece("Ground", unseen=Unseen.HOLDOUT), "dropped"),
        # The tree is scattered over the ground, which carries it but mustn't pass on its name.
        (piece("Oak", link("Ground", "Terrain")), "obstacle"),
        (piece(link("Oak", "Landscape"), scattered=True), "obstacle"),
        (piece("Ground", scattered=True, anonymous=True), "obstacle"),
        (piece("GroundTile", scattered=True), "ground"),
    ],
)
def test_ground_by_name_of_object_then_mesh_then_collection(thing: Piece, use: str) -> None:
    assert scenery_uses(thing) == [use]


def test_a_scenery_listed_as_a_vehicle_is_refused_unless_options_are_given() -> None:
    files = [piece("Ground", size=(200, 200, 5)), piece("House", size=(40, 10, 10))], [piece("Water", size=(99, 99, 0))]
    for pieces in files:
        with pytest.raises(AssetError, match=r"looks like a scenery but is listed as a vehicle: .* \[\[assets.scener"):
            refuse_or_doubt_kind("vehicle", pieces, Options())
        assert refuse_or_doubt_kind("scenery", pieces, Options()) is None
        for options in (Options(scale=0.01), Options(keep=("house",)), Options(drop=("ground",))):
            assert refuse_or_doubt_kind("vehicle", pieces, options) is None


def test_a_parent_of_everything_is_no_helper_and_a_glacier_is_no_vehicle() -> None:
    parent = link("b21_collision", kind="EMPTY")
    pieces = [replace(p, chain=(*p.chain, parent)) for p in (piece("base"), piece("top"))]
    assert vehicle_uses(*pieces) == ["vehicle", "vehicle"]
    assert vehicle_uses(*pieces, piece("hull")) == ["dropped", "dropped", "vehicle"]
    assert vehicle_uses(piece("base_collision"), piece("top_collision")) == ["dropped", "dropped"]
    glacier = piece("mesh0", size=(9200, 6600, 2400), level=0.82, filled=0.54)
    assert likely_kind([glacier], Options()) == "scenery"
    assert scenery_uses(glacier) == ["ground"]
    assert likely_kind([replace(glacier, level=0.4, filled=1.6)], Options()) == "vehicle"


def test_a_tank_in_centimeters_is_not_a_scenery() -> None:
    tank = [piece("Hull", size=(600, 300, 100), at=(0, 0, 100)), piece("Track_L", size=(600, 60, 90), at=(0, 150, 45))]
    assert scenery_uses(*tank) == ["obstacle", "ground"]
    assert refuse_or_doubt_kind("vehicle", tank, Options()) is None
    (doubt,) = vehicle_doubts(FileReport("vehicle", "", (600.0, 360.0, 150.0), 0, 1.0, "z"), Options())
    assert doubt.kind == DoubtKind.SCALE
    assert "600 m long; set scale = 0.01 (now 1)" in doubt.text
    with pytest.raises(AssetError, match=r"it contains ground \('Track_L'\)"):
        refuse_or_doubt_kind("vehicle", [piece("Slope", size=(600, 300, 100)), tank[1]], Options())


def test_a_vehicle_listed_as_a_scenery_is_refused_by_its_names() -> None:
    floor = piece("Floor", size=(50, 50, 0.1))
    for pieces in ([HULL], [floor, HULL]):
        with pytest.raises(AssetError, match=r"looks like a vehicle but is listed as a scenery: it contains 'Hull'"):
            refuse_or_doubt_kind("scenery", pieces, Options())
        assert refuse_or_doubt_kind("vehicle", pieces, Options()) is None
        assert refuse_or_doubt_kind("scenery", pieces, Options(ground=("Floor",))) is None
    rocks = [piece("Rock", size=(6, 3, 1))]
    doubt = refuse_or_doubt_kind("scenery", rocks, Options())
    assert doubt is not None
    assert doubt.kind == DoubtKind.OTHER_KIND
    assert refuse_or_doubt_kind("scenery", [floor, *rocks], Options()) is None
    town = [piece("House", size=(9, 9, 9)), piece("Cartwheel", at=(90, 0, 0)), piece("wheel", at=(90, 0, 0))]
    assert refuse_or_doubt_kind("scenery", town, Options()) is None


def parts_in(pieces: list[Piece], points: list[np.ndarray], *, markers: tuple = (), **options: str) -> Parts:
    """The parts of pieces with these vertices, without solids."""
    return find_parts(PlacedPieces(pieces, points, find_solids((), ()), markers, np.eye(4)), Options(**options))


def parts_of(*chains: tuple[Link, ...] | Link, **more: object) -> tuple[dict[str, str], Parts]:
    """The part of each object; each object is a small box at its origin."""
    pieces = [piece(*(c if isinstance(c, tuple) else (c,))) for c in chains]
    cube = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    points = [cube + p.chain[0].pose[:3, 3] for p in pieces]
    found = parts_in(pieces, points, **more)
    names = ["hull", *(row.name for row in found.moving)]
    return {p.name: names[i] for p, i in zip(pieces, found.piece_part, strict=True)}, found


def test_children_of_a_turret_belong_to_it_and_carry_its_gun() -> None:
    turret, gun = link("Turret_01", kind="EMPTY", at=(1, 0, 2)), link("Gun.001", kind="EMPTY", at=(2, 0, 2.2))
    belongs, parts = parts_of(link("Hull"), (link("Dome"), turret), (link("Tube", at=(4, 0, 2.2)), gun, turret))
    assert belongs == {"Hull": "hull", "Dome": "turret", "Tube": "gun"}
    assert [(row.parent, row.pivot, row.axis) for row in parts.moving] == [
        ("hull", (1, 0, 2), (0, 0, 1)),
        ("turret", (2, 0, 2.2), (0, -1, 0)),
    ]


@pytest.mark.parametrize(
    ("chains", "options", "expected"),
    [
        # The vehicle's name isn't used for parts.
        ((link("A", "SAM launcher"), link("B", "SAM launcher")), {}, ("hull", "hull")),
        ((link("A", "x", "SPG gun"), link("Turret", "x", "SPG gun")), {}, ("hull", "turret")),
        ((link("Only turret"),), {}, ("hull",)),
        # A launcher is a turret only if there's no other turret, and a smoke launcher never is.
        ((link("Hull"), link("Launcher")), {}, ("hull", "turret")),
        ((link("Hull"), link("Smoke_Launcher")), {}, ("hull", "hull")),
        ((link("Hull"), link("Machine_Gun"), link("MG barrel"), link("Oil_barrel")), {}, ("hull",) * 4),
        # Both words in one name.
        ((link("Hull"), link("Gun_Turret")), {}, ("hull", "turret")),
        ((link("Hull"), link("Turret"), link("Turret_Gun")), {}, ("hull", "turret", "gun")),
        # Words inside words count only if no whole word matches.
        ((link("Hull"), link("turretpivot"), link("gunbarrel", at=(3, 0, 0))), {}, ("hull", "turret", "gun")),
        ((link("Hull"), link("Turret"), link("turretshelf"), link("Gun", at=(3, 0, 0))), {},
         ("hull", "turret", "turret", "gun")),
        # A helper named for a part isn't the part where something else is.
        ((link("Hull"), link("turretpivot", at=(1, 0, 0)), link("Turm_03")), {}, ("hull", "turret", "turret")),
        # The closest name decides.
        ((link("Hull"), link("Turret", "Guns"), (link("Sight"), link("Turret")), link("Tube", "Guns")), {},
         ("hull", "turret", "turret", "gun")),
        # Names in the config replace the words.
        ((link("Turret"), link("Turm"), link("Rohr")), {"turret": "Turm", "gun": "roh*"}, ("hull", "turret", "gun")),
        ((link("Hull"), link("Turret")), {"turret": ""}, ("hull", "hull")),
    ],
)  # fmt: skip
def test_names_of_parts(chains: tuple, options: dict, expected: tuple[str, ...]) -> None:
    assert tuple(parts_of(*chains, **options)[0].values()) == expected


def test_an_empty_without_children_can_be_a_pivot() -> None:
    marker = (link("Pivot", "Turret", kind="EMPTY", at=(0.3, 0.1, 0)),)
    _, parts = parts_of(link("Hull", "Rest"), link("a", "Turret"), link("b", "Turret"), markers=(marker,))
    assert parts.moving[0].pivot == (0.3, 0.1, 0)
    assert parts.moving[0].why == "origin of 'Pivot', named pivot"


def test_a_gun_does_not_turn_about_its_center() -> None:
    pieces = [piece("Hull"), piece("Barrel", at=(4, 0, 2))]
    tube = np.array([[x, y, z] for x in (2.0, 6.0) for y in (-0.1, 0.1) for z in (1.9, 2.1)])
    middle = Piece("m", (link("Barrel", at=(4, 0, 2)),), 0, np.eye(4), pieces[1].bounds, 12)
    (gun,) = parts_in([pieces[0], middle], [np.zeros((1, 3)), tube]).moving
    assert gun.pivot == (2.0, 0.0, 2.0)
    assert "is not where a gun turns" in gun.why


@pytest.mark.parametrize("yaw", [0.0, 90.0, 180.0, -90.0, 37.0])
def test_positive_angles_raise_a_gun_in_any_direction(yaw: float) -> None:
    c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    tube = np.array([[x, y, z] for x in (0.0, 4.0) for y in (-0.1, 0.1) for z in (1.9, 2.1)]) @ turn.T
    pieces = [piece("Hull"), Piece("m", (link("Gun", kind="EMPTY", at=(0, 0, 2)),), 0, np.eye(4), np.zeros((2, 3)), 12)]
    (gun,) = parts_in(pieces, [np.zeros((1, 3)), tube]).moving
    assert np.allclose(gun.axis, turn @ [0, -1, 0], atol=1e-6)
