"""Water, ground, sky objects, and removed objects in files read by Blender; what isn't planned isn't rendered."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hulldown.assets.bundle import load_scenery
from hulldown.assets.scenery import Scenery
from hulldown.placement.terrain import Terrain
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import Exported, export_asset
from hulldown.tests.builders.blender_plans import run_python

SCRIPT = "water_blends.py"
SHOWN = """
import json, sys
from hulldown.reading.blender.capture import visit_render_depsgraph
from hulldown.render.blender.scene import BlenderScene
stage = BlenderScene(sys.argv[1])
shown = []
def look(depsgraph):
    for instance in depsgraph.object_instances:
        if instance.show_self and instance.object.type == "MESH" and instance.object.data.polygons:
            shown.append(instance.object.name.partition(".")[0])
visit_render_depsgraph(stage.scene, look)
print("shown", json.dumps(sorted(shown)))
"""


def read(written: Path, name: str, **patterns: tuple[str, ...]) -> tuple[Exported, Scenery]:
    exported = export_asset(written / name, written, kind="scenery", options=replace(Options(), **patterns))
    return exported, load_scenery(exported.bundle)


def water_of(scenery: Scenery) -> list[str]:
    return sorted({scenery.instance_names[i] for i in np.flatnonzero(scenery.instance_is_water)})


def assert_what_is_planned_is_rendered(exported: Exported, scenery: Scenery) -> None:
    """Compare names without the numbers that copies get when the tidy twin is written."""
    planned = sorted(name.partition(".")[0] for name in (*scenery.ground_names, *scenery.instance_names))
    shown = run_python("-c", SHOWN, exported.tidy)
    assert json.loads(shown.rpartition("shown ")[2]) == planned


@pytest.mark.blender
def test_ground_by_shape_and_water_by_name_also_in_instances(written: Path) -> None:
    exported, scenery = read(written, "named.blend")
    assert scenery.ground_names == ("Plane.003",)
    assert any(doubt.text.startswith("taken as ground: 'Plane.003', by shape") for doubt in exported.report.doubts)
    assert water_of(scenery) == ["Teich", "Wasserfläche"]
    water = scenery.water_surface()
    assert water is not None
    z = Terrain(water).top_hits([[0.0, 40.0], [40.0, 40.0], [-40.0, -40.0], [79.0, 79.0]]).z
    assert np.allclose(z, [5.0, 6.0, -1.0, np.nan], equal_nan=True)


@pytest.mark.blender
@pytest.mark.parametrize("name", ["dressed.blend", "dressed.glb"])
def test_water_by_material_excludes_leaves(written: Path, name: str) -> None:
    _, scenery = read(written, name)
    assert scenery.ground_names == ("Plane",)
    assert water_of(scenery) == sorted(["Flat.001", "Upright", *(["Ocean"] if name.endswith("blend") else [])])
    _, none = read(written, name, water=())
    assert water_of(none) == []


@pytest.mark.blender
def test_faces_of_the_ground_with_a_water_material_are_water(written: Path) -> None:
    exported, scenery = read(written, "worn.blend")
    assert water_of(scenery) == ["Terrain"]
    water, ground = scenery.water_surface(), scenery.ground
    assert water is not None
    assert ground is not None
    xy = [[50.0, 50.0], [-50.0, 50.0], [50.0, -50.0]]
    assert np.isfinite(Terrain(water).top_hits(xy).z).tolist() == [True, False, False]
    assert np.isfinite(Terrain(ground).top_hits(xy).z).tolist() == [False, True, True]
    assert scenery.ground_names == ("Terrain", "North terrain")
    doubts = [doubt.text for doubt in exported.report.doubts]
    assert "taken as water: the faces of 'Terrain' that wear water; if they are ground, set water = []" in doubts
    assert any(doubt.startswith("'North terrain' is ground and wears 'Falling water'") for doubt in doubts)
    _, dry = read(written, "worn.blend", water=())
    assert dry.water_surface() is None
    assert np.isfinite(Terrain(dry.ground).top_hits(xy).z).all()


@pytest.mark.blender
@pytest.mark.parametrize(
    ("drop", "gone"),
    [
        pytest.param(("bed of oaks",), {"Bed of oaks", "Oak"}, id="what scatters, and so what it scatters"),
        pytest.param(("collection:kept",), {"Teich"}, id="a collection that is instanced"),
    ],
)
def test_dropped_objects_are_neither_planned_nor_rendered(written: Path, drop: tuple[str, ...], gone: set[str]) -> None:
    _, all_of_it = read(written, "named.blend")
    exported, scenery = read(written, "named.blend", drop=drop)
    kept = {*scenery.ground_names, *scenery.instance_names}
    assert {*all_of_it.ground_names, *all_of_it.instance_names} - kept == gone
    assert_what_is_planned_is_rendered(exported, scenery)


@pytest.mark.blender
@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        pytest.param({}, [], id="names"),
        pytest.param({"ground": ("terrain_n",)}, ["Terrain_N"], id="ground by the config, mesh called like a sky"),
    ],
)
def test_rendered_objects_are_the_planned_ones(
    written: Path, patterns: dict[str, tuple[str, ...]], expected: list[str]
) -> None:
    exported, scenery = read(written, "sky.blend", **patterns)
    assert sorted([*scenery.ground_names, *scenery.instance_names]) == sorted([*expected, "Inner rock", "Rock"])
    assert_what_is_planned_is_rendered(exported, scenery)
