"""Roles of objects in files as people make them: vehicle, part, ground, obstacle, dropped."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hulldown.reading.pieces.doubt import DoubtKind
from hulldown.tests.builders.messy_export import Messy

pytestmark = pytest.mark.blender


def test_dropped_objects_have_a_reason(messy: Messy) -> None:
    rows = {row.name: row for row in messy.exported["clutter"].report.rows}
    reasons = {
        "Floor": "matches 'floor' and reaches",
        "Object_17": "a flat sheet",
        "shadowCatcher.002": "matches 'shadow catcher'",
        "UCX_Hull_01": "matches 'ucx'",
        "Backdrop": "matches 'backdrop'",
        "ground": "is at the underside",
        "ref_side": "matches 'ref' and reaches",
        "Catcher": "a shadow catcher",
        "Ghost": "invisible to the camera",
        "Key": "type light",
        "Camera": "type camera",
    }
    for name, why in reasons.items():
        assert rows[name].use == "dropped"
        assert why in rows[name].why
    assert {n for n, row in rows.items() if row.use != "dropped"} == {
        *("Hull", "Nose", "Dome", "Tube", "Cabin_Floor", "Plane.004")
    }


def test_loose_vertices_are_ignored(messy: Messy) -> None:
    assert messy.asset("surfaces").mesh.vertices[:, 2].max() < 4


def test_origins_at_zero_are_not_used_as_pivots(messy: Messy) -> None:
    shape = messy.asset("no_origins")
    reports = messy.exported["no_origins"].report
    inside = shape.mesh.vertices[shape.vertex_part == 1]
    assert ((shape.part_pivot[1] >= inside.min(axis=0)) & (shape.part_pivot[1] <= inside.max(axis=0))).all()
    assert all("is not where" in part.why for part in reports.parts)
    assert sum(doubt.kind == DoubtKind.PIVOT for doubt in reports.doubts) == 2


def test_a_turret_can_be_a_collection_or_a_bone(messy: Messy) -> None:
    report = messy.exported["collections"].report
    assert report.parts[0].why == "origin of 'pivot', named pivot"
    assert messy.uses("collections") == {"Body": {"hull"}, "a": {"turret"}, "b": {"turret"}, "c": {"gun"}}
    assert messy.exported["armature"].report.parts[0].why == "origin of 'turret'"


def test_objects_of_an_fbx_are_read_by_name(messy: Messy) -> None:
    """Blender's importer has another order in each process, and so had bundles and plans."""
    names = [row.name for row in messy.exported["fbx"].report.rows if row.triangles]
    assert names == sorted(names)


def test_scenery_ground_and_obstacles(messy: Messy) -> None:
    scenery = messy.asset("scattered")
    assert sorted(scenery.ground_names) == ["Cube.001", "Ground_cubes", "Ground_spread"]
    names = list(scenery.instance_names)
    assert (names.count("Oak"), names.count("Pebble"), names.count("Ground_cubes")) == (12 + 3, 9 + 3, 4)
    # Oak, pebble, and the cube of the geometry nodes: one mesh each for all instances.
    assert len(scenery.obstacle_meshes) == 3
    for mesh in scenery.obstacle_meshes:
        assert np.array_equal(mesh.extreme, replace(mesh, extreme=None).extreme_vertex_indices()), "stored for planning"
    assert messy.uses("scattered")["Skydome"] == {"backdrop"}
    for name in ("Volume", "Terrain_LOD1", "Terrain_LOD2"):
        assert messy.uses("scattered")[name] == {"dropped"}
    assert sum(row.count for row in messy.exported["scattered"].report.rows if row.name == "Oak") == 15


def test_map_coordinates_in_the_object_keep_its_children_exact(messy: Messy) -> None:
    scenery = messy.asset("map_in_object")
    assert scenery.origin.tolist() == [500_000.0, 5_400_000.0, 0.0]
    assert scenery.ground is not None
    assert np.allclose(scenery.ground.bounds[:, :2], [[-32, -32], [32, 32]], atol=1e-5)
    # Blender's float32 matrices would give 3.0 or 3.03125 and 2.5 or 3.0.
    places = dict(zip(scenery.instance_names, scenery.world_from_instance[:, :3, 3], strict=True))
    assert np.allclose(places["Hut"], [3.14159, 2.71828, 201.41421], atol=1e-6)
    # A float32 rotation would move the barn by 0.15 m.
    east, north = Rotation.from_euler("z", np.float32(0.1)).apply([1_036_604.5, 5_323_106.0, 0.0])[:2]
    assert np.allclose(places["Barn"], [east - 500_000.0, north - 5_400_000.0, 201.0], atol=1e-6)


def test_map_coordinates_in_the_mesh_equal_those_of_the_file(messy: Messy) -> None:
    scenery = messy.asset("map_in_mesh")
    assert scenery.origin.tolist() == [500_000.0, 5_400_000.0, 0.0]
    assert scenery.ground is not None
    held = np.unique(np.float32(np.linspace(-32, 32, 5) + 5_400_000.0).astype(float) - 5_400_000.0)
    assert np.unique(scenery.ground.vertices[:, 1]).tolist() == held.tolist()


def test_geometry_by_nodes_belongs_to_the_part_that_carries_it(messy: Messy) -> None:
    uses = messy.uses("nodes")
    assert uses["Knob"] == {"hull"}
    assert uses["Turret"] == {"turret"}
    assert messy.asset("nodes").mesh.bounds[1, 0] > 3.1
