"""Pieces of a vehicle's file that may not belong to it."""

import json

import numpy as np
import pytest

from hulldown.geometry.meshes import Mesh
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.tests.builders.loose_parts import TANK, box, read, turned
from hulldown.tests.builders.shapes import sheet


def card(y: float, low: float) -> Mesh:
    """An upright sheet along a vehicle."""
    level = sheet((-5, low), (5, 5), y)
    return level.with_vertices(level.vertices[:, [0, 2, 1]])


@pytest.mark.parametrize(
    ("name", "mesh", "hidden", "what"),
    [
        ("Thing", box((0.5, 0.5, 1), (0, 0, 2)), True, "hidden from the viewport, but rendered"),
        ("Keel", box((0.5, 0.5, 1), (0, 0, 0.2)), False, "reaching below the wheels"),
        ('"Keel"\n', box((0.5, 0.5, 1), (0, 0, 0.2)), False, "reaching below the wheels"),
        ("Cube", box((0.8, 0.8, 0.8), (0, 0, 2.5)), False, "a new mesh of Blender's"),
        ("Block", box((0.4, 0.4, 1), (0, 1.9, 0.5)), False, "not touching the rest"),
        ("Card", card(0, 0), False, "sticks out of the rest"),
    ],
)  # fmt: skip
def test_pieces_that_may_not_belong_are_doubted_with_a_drop_pattern(name: str, mesh: Mesh, hidden: bool, what: str) -> None:
    built = read(TANK | {name: mesh}, hidden=(name,) * hidden)
    (doubt,) = [d.text for d in built.doubts if d.kind == DoubtKind.STRAY]
    assert doubt.startswith(f"{name!r}: ")
    assert what in doubt
    assert f"set drop = {json.dumps([name])} if" in doubt


BALL_ON_A_ROD = {"Rod": box((0.2, 0.2, 0.9), (-3.05, 0, 0.3)), "Ball": box((0.8, 0.4, 0.4), (-3.6, 0, 0.3))}


@pytest.mark.parametrize(
    "others",
    [{"Crate": box((2, 2, 2), (0, 0, 0.9))}, BALL_ON_A_ROD],
    ids=["much of the surface", "the ball would touch nothing"],
)
def test_no_doubt_proposes_to_drop_much_or_in_vain(others: dict[str, Mesh]) -> None:
    (doubt,) = [d.text for d in read(TANK | others).doubts if d.kind == DoubtKind.STRAY]
    assert doubt.startswith(f"{next(iter(others))!r}: ")
    assert "look at it, and name it in drop" in doubt


STUDIO = Mesh(
    np.array([[x, y, z] for y in (-12.0, 12.0) for x, z in ((12.0, 0.0), (-9.0, 0.0), (-11.0, 2.0), (-11.0, 9.0))]),
    np.array([[k, k + 1, k + 4] for k in range(3)] + [[k + 1, k + 5, k + 4] for k in range(3)]),
)


@pytest.mark.parametrize(
    ("name", "mesh", "hidden", "reasons"),
    [
        ("Cube", box((2, 2, 2), (0, 0, 1.0)), True, ()),
        ("Cube", box((2, 2, 2), (0, 0, -0.2)), False, ("reaches below the wheels",)),
        ("Blueprint", card(1, -1), True, ()),
        ("Sheet_2", card(1, -1), False, ("reaches below the wheels",)),
        ("Cyc", STUDIO, False, ()),
        ("Plinth", box((9, 4, 0.4), (0, 0, -0.2)), False, ()),
        ("Object_9", box((9, 4, 0.4), (0, 0, -0.2)), False, ()),
        ("Lamp_Card", box((2, 2, 0.01), (0, 0, 5)), False, ("far from the rest",)),
        ("Human_Reference", box((0.4, 0.4, 1.8), (0, 3.5, 0.9)), False, ()),
    ],
)
@pytest.mark.parametrize("yaw", [0.0, 33.0])
def test_pieces_with_two_signs_of_not_belonging_are_left_out(
    name: str, mesh: Mesh, hidden: bool, reasons: tuple, yaw: float
) -> None:
    parts, pose, unseen = TANK | {name: mesh}, turned(yaw), (name,) * hidden
    built = read(parts, pose, hidden=unseen)
    alone = read(TANK)
    assert [r.use for r in built.roles] == [*(r.use for r in alone.roles), "dropped"]
    assert np.allclose(built.shape.size_xyz, alone.shape.size_xyz, atol=1e-6)
    keeps = [d.text for d in built.doubts if d.text.startswith(f"{name!r}: ")]
    assert len(keeps) == len(reasons)
    assert all(what in keeps[0] and f'set keep = ["{name}"]' in keeps[0] for what in reasons)
    uses = {r.use for r in read(parts, pose, hidden=unseen, keep=(name,)).roles}
    assert uses == {r.use for r in alone.roles}


def test_a_wide_hull_under_a_turret_is_not_a_backdrop() -> None:
    hull = box((8, 5, 1), (0, 0, 1))
    open_below = hull.take_mesh_faces(np.flatnonzero(hull.triangles[:, :, 2].max(axis=1) > 1.0))
    built = read({"Hull": open_below, "Dome": box((1, 1, 0.6), (0, 0, 1.8)), "Hatch": box((0.3, 0.3, 0.1), (0, 0, 2.1))})
    assert all(r.use != "dropped" for r in built.roles)
