"""Up and forward axes, parts, and pivots of vehicles made of plain arrays, in any frame."""

import numpy as np
import pytest

from hulldown.base.errors import AssetError
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.geometry.transforms import axis_rotation, rigid_matrix, transform_points
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.vehicle.solids import MAX_SOLIDS
from hulldown.reading.vehicle.stance import UP_AXES, z_up_rotation
from hulldown.tests.builders.loose_parts import CAR, MIRRORED, TANK, TRUCK, box, kinds, read, tube, turned


@pytest.mark.parametrize("axis", UP_AXES)
@pytest.mark.parametrize("stated", ["z", "y"])
@pytest.mark.parametrize("parts", [TANK, CAR])
def test_wheels_show_the_up_axis_and_overruling_the_file_is_a_doubt(parts: dict, axis: str, stated: str) -> None:
    pose = np.linalg.inv(z_up_rotation(axis))
    built = read(parts, pose, stated=stated)
    assert np.allclose((built.shape.vehicle_from_file @ pose)[2, :3], [0, 0, 1], atol=1e-9)
    doubts = [d.text for d in built.doubts if d.kind == DoubtKind.UP]
    # OBJ files usually have y up; six or more wheels leave only one doubt: which of two directions is forward.
    assert len(doubts) == (stated == "z" and axis != stated and (parts is CAR or axis == "-z"))
    assert all(d.startswith(f"{axis} is taken to be up") and f'set up = "{stated}"' in d for d in doubts)


@pytest.mark.parametrize("yaw", [0.0, 33.0, 60.0, -128.0, 180.0])
def test_a_diagonal_vehicle_is_straightened(yaw: float) -> None:
    built = read(TANK, turned(yaw))
    assert np.allclose(built.shape.size_xyz, read(TANK).shape.size_xyz, atol=1e-6)
    assert DoubtKind.FORWARD not in kinds(built)


@pytest.mark.parametrize("parts", [TANK, TRUCK, MIRRORED])
def test_the_nose_is_at_the_gun_cab_or_mirrors_and_unknown_on_a_bare_box_on_wheels(parts: dict) -> None:
    for yaw in (0.0, 180.0):
        built = read(parts, turned(yaw))
        assert np.allclose(built.shape.vehicle_from_file[:2, 0], [np.cos(np.radians(yaw)), 0], atol=1e-9)
        if parts is MIRRORED:
            assert DoubtKind.FORWARD in kinds(built)
    bare = read({k: m for k, m in TRUCK.items() if k != "Cab"}).doubts
    assert any(d.kind == DoubtKind.FORWARD and 'set forward = "-x"' in d.text for d in bare)


def van(yaw: float) -> Mesh:
    """A single mesh without wheels: a box with a slanted windshield, 5 m along x before it's turned."""
    mesh = box((5, 2, 2), (0, 0, 1.4))
    front = (mesh.vertices[:, 0] > 0) & (mesh.vertices[:, 2] > 1.4)
    mesh = mesh.with_vertices(np.where(front[:, None], mesh.vertices - [0.8, 0, 0], mesh.vertices))
    return mesh.with_vertices(transform_points(turned(yaw), mesh.vertices))


@pytest.mark.parametrize("yaw", [0.0, 90.0, 180.0, -90.0])
def test_a_windshield_shows_the_nose_and_a_nameless_vehicle_lies_along_its_longer_side(yaw: float) -> None:
    built = read({"Mesh_3": van(yaw)})
    assert np.allclose(built.shape.size_xyz, (5, 2, 2))
    assert np.allclose(built.shape.vehicle_from_file[:2, 0], [np.cos(np.radians(yaw)), -np.sin(np.radians(yaw))])
    on_wheels = read({k: m for k, m in TANK.items() if k[0] == "W"} | {"Mesh_3": van(0)}, turned(yaw))
    assert np.allclose(on_wheels.shape.vehicle_from_file[0, :2], [np.cos(np.radians(yaw)), np.sin(np.radians(yaw))])
    assert DoubtKind.FORWARD not in kinds(on_wheels)


@pytest.mark.parametrize("yaw", [0.0, 180.0])
def test_a_barrel_in_the_turrets_mesh_shows_the_nose(yaw: float) -> None:
    merged, _ = merge_meshes_with_sources(
        [box((2.4, 2, 0.7), (0, 0, 1.8)), tube((1.2, 0, 1.8), (5, 0, 1.8), 0.1)], name="turret"
    )
    welded = Mesh(merged.vertices, np.vstack([merged.faces, [0, 8, 9]]))  # one solid
    hull = box((6, 3, 1.2), (0, 0, 0.8))
    built = read({"hull": hull, "turret": welded}, turned(yaw))
    assert np.allclose(built.shape.vehicle_from_file[0, 0], np.cos(np.radians(yaw)))
    assert DoubtKind.FORWARD not in kinds(built)
    nameless = read({"Object_0": merge_meshes_with_sources([hull, welded], name="it")[0]}, turned(yaw))
    assert np.allclose(nameless.shape.vehicle_from_file[0, 0], np.cos(np.radians(yaw)))


def test_a_vehicle_whose_mirror_plane_is_level_may_lie_on_its_side() -> None:
    mesh = van(0.0)
    lying = mesh.with_vertices(mesh.vertices[:, [0, 2, 1]] * [1, -1, 1])
    (doubt,) = [doubt for doubt in read({"body": lying}).doubts if doubt.kind == DoubtKind.UP]
    assert 'set up = "-y"' in doubt.text
    lying = mesh.with_vertices(mesh.vertices[:, [0, 2, 1]])
    assert any('set up = "y"' in doubt.text for doubt in read({"body": lying}).doubts)
    assert DoubtKind.UP not in kinds(read({"body": mesh}))


def test_names_of_wheels_outweigh_a_rack_and_the_body_is_no_stray() -> None:
    ends = {f"wheel-{'front' if mesh.vertices[:, 0].mean() > 0 else 'back'}-{k}": mesh
            for k, mesh in CAR.items() if k[0] == "W"}  # fmt: skip
    for x in (-1.6, -2.2):
        rack = tube((x - 2.6, 0, 2.25), (x + 2.6, 0, 2.25), 0.1)
        built = read(ends | {"body": merge_meshes_with_sources([CAR["Hull"], rack], name="body")[0]})
        assert built.shape.vehicle_from_file[0, 0] == 1.0
        assert not {DoubtKind.STRAY, DoubtKind.FORWARD} & set(kinds(built))


def test_a_vehicle_that_reaches_beyond_its_wheels_both_ways_is_not_upside_down() -> None:
    wheels = {k: m for k, m in CAR.items() if k[0] == "W"}
    assert read(wheels | {"Hull": box((5, 2, 2.4), (0, 0, 0.3))}).axes.startswith("up is z, as the file states")


@pytest.mark.parametrize(
    ("options", "nose"),
    [
        ({"forward": "+y"}, 90.0),
        ({"forward": 33.0}, 33.0),
        ({"forward": (1.0, -1.0)}, -45.0),
        # Forward is given for z up: then the file's -z is +y.
        ({"up": "y", "forward": "+y"}, 90.0),
    ],
)
def test_forward_is_an_axis_an_angle_or_a_vector_once_z_is_up(options: dict, nose: float) -> None:
    built = read(TANK, **options)
    upright = built.shape.vehicle_from_file[:3, :3] @ z_up_rotation(str(options.get("up", "z")))[:3, :3].T
    assert np.allclose(upright @ [np.cos(np.radians(nose)), np.sin(np.radians(nose)), 0], [1, 0, 0], atol=1e-9)
    if "up" in options:
        assert np.allclose(built.shape.vehicle_from_file[:3, :3] @ [0, 0, -1], [1, 0, 0], atol=1e-9)


def test_origins_at_zero_are_not_pivots_but_the_turret_ring_is() -> None:
    built = read(TANK)
    shift = np.linalg.inv(built.shape.vehicle_from_file)
    turret, gun = transform_points(shift, built.shape.part_pivot[1:])
    assert np.allclose(turret[:2], [0.1, 0], atol=1e-6)
    assert abs(gun[0] - 1.0) < 0.05
    assert abs(gun[2] - 1.9) < 1e-6
    assert built.parts[0].why.startswith("the middle of its ring, a circle of 1.")
    assert [d for d in built.doubts if d.kind == DoubtKind.PIVOT and "gun_pivot" in d.text]


@pytest.mark.parametrize(
    "pose", [turned(0.0), turned(-128.0), np.linalg.inv(z_up_rotation("-z")), np.linalg.inv(z_up_rotation("x"))]
)
def test_what_reading_had_to_guess_can_be_stated_as_keys(pose: np.ndarray) -> None:
    for parts in (TANK, {k: m for k, m in TRUCK.items() if k != "Cab"}):
        built = read(parts, pose)
        guessed = {doubt.key: doubt.taken for doubt in built.doubts if doubt.key}
        again = read(parts, pose, **guessed)
        assert guessed
        assert not [doubt for doubt in again.doubts if doubt.key]
        # Angles are rounded to tenths of degrees.
        assert np.allclose(again.shape.vehicle_from_file, built.shape.vehicle_from_file, atol=1e-3)
        assert np.allclose(again.shape.part_pivot, built.shape.part_pivot, atol=1e-2)


def test_pivots_in_the_config_are_used() -> None:
    pose = turned(90.0)
    built = read(TANK, pose, turret_pivot=(0.0, 0.3, 1.5), gun_pivot="Hull")
    assert np.allclose(
        transform_points(np.linalg.inv(built.shape.vehicle_from_file), built.shape.part_pivot[1:]), [[0, 0.3, 1.5], [0, 0, 0]]
    )
    assert not built.doubts
    with pytest.raises(Exception, match="gun_pivot = 'Axle' is no object or empty"):
        read(TANK, gun_pivot="Axle")


def test_drums_at_the_rear_are_not_guns() -> None:
    drums = {f"barrel{i}": tube((-3.2, y, 1.3), (-3.2, y + 0.9, 1.3), 0.28) for i, y in ((1, -1.0), (2, 0.1))}
    built = read(TANK | drums)
    names = [*TANK, *drums]
    uses = dict(zip(names, built.piece_part, strict=True))
    assert [uses["barrel1"], uses["barrel2"], uses["Gun"]] == [0, 0, 2]
    assert "no gun" in built.roles[names.index("barrel1")].why
    without = read({k: m for k, m in (TANK | drums).items() if k != "Gun"})
    assert any(d.kind == DoubtKind.PARTS and "set gun" in d.text for d in without.doubts)


def test_unnamed_parts_are_found_by_shape_or_doubted() -> None:
    numbered = {f"Object_{i}": mesh for i, mesh in enumerate(TANK.values())}
    doubts = read(numbered).doubts
    assert any(d.kind == DoubtKind.PARTS and "set gun, and turret" in d.text for d in doubts)
    plain = {f"Object_{i}": mesh for i, (name, mesh) in enumerate(TANK.items()) if name != "Gun"}
    assert DoubtKind.PARTS in kinds(read(plain))


def test_objects_on_a_turret_without_children_turn_with_it() -> None:
    parts = {k: m for k, m in TANK.items() if k != "Turret_Ring"} | {"Hatch": box((0.5, 0.5, 0.1), (-0.4, 0.4, 2.35))}
    built = read(parts)
    assert built.piece_part[list(parts).index("Hatch")] == 1
    assert any(d.kind == DoubtKind.PARTS and "'Hatch'" in d.text for d in built.doubts)


def test_launch_tubes_point_ahead_and_turn_at_the_top_of_their_plates() -> None:
    rise = rigid_matrix(axis_rotation([0.0, -1.0, 0.0], 0.4), [-0.8, 0.0, 1.8])
    tubes = {f"Launch_Gun_{i}": tube((-3, y, 0.8), (2.0, y, 0.8), 0.3) for i, y in enumerate((-0.8, 0.0, 0.8))}
    raised = {k: m.with_vertices(transform_points(rise, m.vertices)) for k, m in tubes.items()}
    plates = {f"Turret_Plate_{s}": box((1.0, 0.1, 0.8), (-1.0, 0.9 * s, 2.0)) for s in (-1, 1)}
    base = {k: m for k, m in TANK.items() if k != "Gun" and k != "Turret"}
    for yaw in (0.0, 180.0):
        pose = turned(yaw)
        built = read(base | plates | raised, pose)
        assert np.allclose(built.shape.vehicle_from_file[:2, 0], [np.cos(np.radians(yaw)), 0], atol=1e-9)
        at = built.shape.part_pivot[built.shape.part_names.index("gun")]
        inner = transform_points(np.linalg.inv(built.shape.vehicle_from_file @ pose), at[None])[0]
        assert np.allclose(inner, [-1.0, 0, 2.2], atol=1e-6)
        assert not any("gun_pivot" in doubt.text for doubt in built.doubts)


TUBES = {f"cannon_{k}": tube((-2.75, y, z), (2.75, y, z), 0.12, sides=12)
         for k, (z, y) in enumerate((z, y) for z in (0.0, 0.3) for y in (-0.45, -0.15, 0.15, 0.45))}  # fmt: skip
LORRY = {
    **{f"W{x}{y}": tube((x, y - 0.15, 0.5), (x, y + 0.15, 0.5), 0.5) for x in (-3.4, -2.2, 2.8) for y in (-1.1, 1.1)},
    "chassis": box((9, 2.5, 0.5), (0, 0, 1)), "cab": box((1.8, 2.5, 1.6), (3.6, 0, 2)),
    "windshield": box((0.05, 2.2, 0.7), (4.52, 0, 2.5)), "towhook": box((0.3, 0.3, 0.3), (-4.6, 0, 1)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("rise_deg", "named", "words"),
    [
        (40.0, False, "only its raised tubes tell"),
        (40.0, True, "what is named front is at the other"),
        (6.0, True, "names of what is in front"),  # flat tubes are no evidence
    ],
)
def test_names_outweigh_tubes_that_rise_at_the_tail(rise_deg: float, named: bool, words: str) -> None:
    rise = rigid_matrix(axis_rotation([0.0, 1.0, 0.0], np.radians(rise_deg)), [-1.5, 0.0, 2.6])
    lorry = LORRY if named else {k.replace("cab", "body_a"): m for k, m in LORRY.items() if k[:3] not in ("win", "tow")}
    built = read(lorry | {k: m.with_vertices(transform_points(rise, m.vertices)) for k, m in TUBES.items()})
    assert words in f"{built.axes} {built.doubts}"
    assert (DoubtKind.FORWARD in kinds(built)) == (rise_deg > 10)
    assert (built.shape.vehicle_from_file[0, 0] > 0) == named  # the cab is in front


def test_helpers_named_for_a_part_are_pivots_and_objects_on_the_turret_turn() -> None:
    pivots = {"turretpivot": box((0.1, 0.1, 0.1), (0.5, 0, 1.5)), "gun_axis": box((0.1, 0.1, 0.1), (1.3, 0, 1.95))}
    aboard = {"turretgunbase": box((0.6, 0.6, 0.3), (0.6, 0, 2.4)), "gun_rack": box((0.4, 1.5, 0.3), (-1.2, 0, 2.45))}
    built = read(TANK | pivots | aboard)
    uses = dict(zip((TANK | pivots | aboard), (role.use for role in built.roles), strict=True))
    assert {uses[name] for name in ("turretgunbase", "gun_rack", "turretpivot")} == {"turret"}
    assert uses["gun_axis"] == "gun"
    _, turret, gun = built.shape.part_pivot
    np.testing.assert_allclose(gun - turret, [0.8, 0.0, 0.45], atol=1e-9)


def test_a_tire_and_its_rim_are_one_wheel() -> None:
    rims = {f"rim{k}": m.with_vertices(m.vertices * [1, 1.03, 1]) for k, m in CAR.items() if k[0] == "W"}
    assert "4 wheels" in read(CAR | rims).axes


def test_a_protruding_gun_shows_the_front_of_a_hull() -> None:
    """The gun's mesh includes its mantlet, so it isn't a slender barrel."""
    stub, _ = merge_meshes_with_sources([box((1, 1.2, 1), (1.5, 0, 2)), box((2.6, 0.5, 0.5), (-1, 0, 2.1))])
    hull = {k: m for k, m in CAR.items() if k != "Cab"} | {"Casemate": box((2, 2.4, 1), (1.8, 0, 2))}
    built = read(hull | {"Mesh_Canon": stub})
    assert "'Mesh_Canon' sticks out there" in built.axes
    assert DoubtKind.FORWARD not in kinds(built)


def test_a_vehicle_on_a_show_platform_faces_along_its_gun() -> None:
    shown = {"body": box((6, 3, 1), (0, 0, 1)), "tower": TANK["Turret"], "gun": TANK["Gun"]}
    shown |= {"crate": box((1.2, 2, 0.7), (2.2, 2, 0.65)), "mine": box((0.7, 0.4, 0.4), (-1.1, -2, 0.5))}
    built = read(shown | {"Show_Platform": box((11, 11, 0.3), (0, 0, 0.15))}, turned(90.0))
    assert [role.use for role in built.roles] == ["hull", "turret", "gun", "hull", "hull", "dropped"]
    assert "along its gun, 'gun' points ahead" in built.axes


def test_a_vehicle_is_read_beside_thousands_of_larger_solids() -> None:
    # Fuzzing found it: all of the vehicle's solids were left out for the trees', and Blender's process ended.
    trees = {f"Tree{k}": box((9, 9, 9), (20 * (k % 70), 20 * (k // 70) + 20, 0)) for k in range(MAX_SOLIDS)}
    built = read(TANK | trees, turned(120), drop=("Tree*",))
    assert np.allclose(built.shape.size_xyz, read(TANK).shape.size_xyz, atol=1e-6)
    assert built.shape.part_names == ("hull", "turret", "gun")


def test_a_sheet_on_its_edge_is_refused_when_read():
    """Planning crashed with it."""
    sheet = Mesh(np.array([[-0.5, 0, 0], [0.5, 0, 0], [-0.5, 0, 1.0]]), np.array([[0, 1, 2]]))
    with pytest.raises(AssetError, match="no length or no width"):
        read({"Hull": sheet})
