"""Several things in one file: vehicles side by side, copies drawn over each other, and vehicles in a scenery."""

import numpy as np
import pytest
import trimesh

from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Evaluated, Link, Piece
from hulldown.reading.scenery.parked import parked_vehicles
from hulldown.reading.scenery.scenery_roles import scenery_roles
from hulldown.tests.reading.test_build import CAR, TANK, TRUCK, box, read, tube, turned

SEVERAL = DoubtKind.SEVERAL


def moved(parts, by, names="{}", size=1.0):
    return {names.format(name): mesh.with_vertices(mesh.vertices * size + by) for name, mesh in parts.items()}


def coarser(mesh, size=1.0):
    hull = trimesh.Trimesh(mesh.vertices * size, mesh.faces).convex_hull
    return Mesh(hull.vertices, hull.faces)


PAIR = moved(TANK, (0, -3, 0), "a_{}") | moved(TANK, (0, 3, 0), "b_{}")
ROW = {k: m for i in range(4) for k, m in moved(CAR, (0, 3.2 * i, 0), f"{{}}.{i:03}" if i else "{}").items()}
CONVOY = moved(TRUCK, (0, 0, 0), "qx_{}") | moved(CAR, (14, 0.7, 0), "zz_{}")
SPREAD = TANK | {"Antenna": tube((-2, 0.5, 2.6), (-2, 0.5, 5), 0.02), "Plate": box((1, 0.1, 0.5), (0, 2.0, 1))}
TRAILER = {"cab": box((5, 2.5, 3), (0, 0, 2)), "box": box((12, 2.5, 3.5), (9, 0, 2.5))}
LEVELS = {k: m for i in range(3) for k, m in moved(TANK, (0, 0, 0), f"{{}}_LOD{i}", 1 + 0.02 * i).items()}
UNNAMED = moved(TANK, (0, 0, 0), "obj{}x") | moved(TANK, (0, 0, 0), "o2{}y", 1.01)
MERGED = TANK | {"shape7": merge_meshes_with_sources(list(TANK.values()), name="it")[0]}
COLLIDER = CAR | {"mesh9": coarser(merge_meshes_with_sources(list(CAR.values()), name="it")[0], 1.01)}
SHELLS = TANK | {"Inner": box((5.4, 2.1, 0.8), (0, 0, 1))}
PAINTED = {
    "Body": box((6, 2.4, 1), (0, 0, 1)),
    "Trim": merge_meshes_with_sources([box((0.1, 2.4, 1), (x, 0, 1)) for x in (-2.95, 2.95)], name="t")[0],
    **{k: TANK[k] for k in TANK if k[0] == "W"},
}


@pytest.mark.parametrize("yaw", [0.0, 33.0])
@pytest.mark.parametrize(("parts", "count"), [(PAIR, 2), (ROW, 4), (CONVOY, 2)])
def test_vehicles_side_by_side_are_proposed_as_entries_that_leave_one_each(parts, count, yaw):
    built = read(parts, turned(yaw))
    assert len(built.things) == count
    assert [kind for kind in (d.kind for d in built.doubts) if kind == SEVERAL] == [SEVERAL]
    for thing in built.things:
        alone = read(parts, turned(yaw), keep=thing.keep, drop=thing.drop)
        assert not alone.things
        assert len([r for r in alone.roles if r.use != "dropped"]) * count == len(parts) or count == 2
        assert max(alone.shape.size_xyz) < 10


def test_a_library_of_vehicles_in_one_place_is_proposed_by_name():
    kit = {name: box(size, (0, 0, 1)) for name, size in
           (("minivan", (4.2, 1.8, 1.5)), ("tow_truck", (4.6, 2, 1.9)), ("hatchback", (3.6, 1.7, 1.4)))}  # fmt: skip
    for more in ({}, {"Wheel": tube((0, 0, 0.3), (0, 0.2, 0.3), 0.3)}):
        assert [thing.keep for thing in read(kit | more).things] == [("minivan",), ("tow_truck",), ("hatchback",)]
    assert not read({"truck_body": box((6, 2, 2), (0, 0, 2)), "tank": box((5, 2, 2), (6, 0, 2)), **more}).things
    assert not read({"truck_paint": kit["minivan"], "truck_glass": kit["tow_truck"]}).things
    assert not read(kit | {"Mesh_7": kit["minivan"]}).things


def test_a_joined_row_is_a_doubt_without_a_key():
    built = read({"row": merge_meshes_with_sources(list(ROW.values()), name="row")[0]})
    assert next(d.text for d in built.doubts if d.kind == SEVERAL).startswith("4 things")
    assert not built.things


@pytest.mark.parametrize("parts", [LEVELS, UNNAMED, MERGED, COLLIDER])
def test_copies_over_each_other_are_proposed_to_be_dropped(parts):
    built = read(parts)
    (thing,) = built.things
    left = read(parts, drop=thing.drop)
    assert not left.things
    assert len([r for r in left.roles if r.use != "dropped"]) == len(CAR if parts is COLLIDER else TANK)
    assert np.allclose(left.shape.size_xyz, read(CAR if parts is COLLIDER else TANK).shape.size_xyz)


@pytest.mark.parametrize("parts", [TANK, CAR, SPREAD, TRAILER, SHELLS, PAINTED])
def test_one_vehicle_is_one_thing(parts):
    assert SEVERAL not in [d.kind for d in read(parts).doubts]


def in_scenery(parts, *, parent=None):
    """The vehicles found in a scenery of these parts, that hang from `parent`."""
    drawn = Evaluated()
    for i, (name, mesh) in enumerate({"Terrain": box((200, 200, 0.1), (0, 0, 0)), **parts}.items()):
        chain = (Link(name, (), "MESH", np.eye(4)), *([Link(parent, (), "EMPTY", np.eye(4))] if parent and i else []))
        drawn.meshes.append(mesh)
        drawn.pieces.append(Piece(name, chain, i, np.eye(4), mesh.bounds, len(mesh.faces), level=float(not i)))
    return parked_vehicles(drawn, scenery_roles(drawn.pieces, Options()), np.eye(4))


BODY = box((4, 1.8, 1.4), (0, 0, 0.7))


@pytest.mark.parametrize(
    ("parts", "found"),
    [
        ({"parked_Car.003": BODY}, ["parked_Car.003"]),
        ({"SUV-red": BODY, "bus stop": BODY, "water_tank": BODY, "Cargo": BODY, "carWheel": BODY}, ["SUV-red"]),
        ({"Car": box((40, 30, 9), (0, 0, 5))}, []),
        ({"Mesh_17": merge_meshes_with_sources(list(CAR.values()), name="m")[0]}, ["Mesh_17"]),
        ({f"part{i}": mesh for i, mesh in enumerate(TRUCK.values())}, ["group9"]),
        ({"hut": BODY, "Mesh_3": box((6, 6, 3), (0, 0, 1.5))}, []),
    ],
)  # fmt: skip
def test_vehicles_in_a_scenery_are_found_by_a_name_or_by_wheels(parts, found):
    named = in_scenery(parts, parent="group9" if found == ["group9"] else None)
    assert list(named) == found
    assert {name for own in named.values() for name in own} == (set(parts) if found == ["group9"] else set(found))
