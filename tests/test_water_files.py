"""Water, ground, and removed objects in files read by Blender; removed objects aren't rendered."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hulldown.assets.bundle import load_scenery
from hulldown.assets.scenery import Scenery
from hulldown.placement.terrain import Terrain
from hulldown.reading.export import Exported, export
from hulldown.reading.options import Options
from hulldown.tests.test_backdrops import assert_what_is_planned_is_rendered

MADE = """
import bpy, sys, math
from hulldown.reading.blender.add_nodes import add_node
from hulldown.tests.node_trees import material_of, principled
folder = sys.argv[1]

def plane(name, size, at=(0, 0, 0), rot=(0, 0, 0), cells=1, wave=0.0):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=cells, y_subdivisions=cells, size=size, location=at)
    made = bpy.context.object
    made.name, made.rotation_euler = name, rot
    for v in made.data.vertices:
        v.co.z = wave * math.sin(v.co.x / 9) * math.cos(v.co.y / 9)
    return made

def cube(name, size, at):
    bpy.ops.mesh.primitive_cube_add(size=size, location=at)
    bpy.context.object.name = name
    return bpy.context.object

def begin():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for x in (-30, 0, 30):
        cube("Kiste", 2, (x, 20, 3))
    return plane("Plane", 160, cells=40, wave=3.0)

# By name, and ground by its shape alone; what is scattered and what scatters are removed.
ground = begin()
ground.name = "Plane.003"
plane("Wasserfläche", 150, (0, 0, -1))
pond = bpy.data.collections.new("kept")
inner = plane("Teich", 12)
for home in inner.users_collection:
    home.objects.unlink(inner)
pond.objects.link(inner)
for i in range(2):
    spot = bpy.data.objects.new(f"spot{i}", None)
    spot.instance_type, spot.instance_collection, spot.location = "COLLECTION", pond, (40 * i, 40, 5 + i)
    bpy.context.scene.collection.objects.link(spot)
oak = cube("Oak", 1, (200, 200, 0))
oak.hide_render = True
bed = plane("Bed of oaks", 30, (0, 0, 4), cells=3)
bed.modifiers.new("p", "PARTICLE_SYSTEM")
settings = bed.particle_systems[0].settings
settings.type, settings.count, settings.use_advanced_hair = "HAIR", 5, True
settings.render_type, settings.instance_object = "OBJECT", oak
bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/named.blend")

# By material.
begin()
gray = 0.5, 0.5, 0.5
plane("Flat.001", 150, (0, 0, -1)).data.materials.append(principled("M1", gray, Transmission_Weight=1.0))
sea = plane("Upright", 60, (0, 0, 2), rot=(math.pi / 2, 0, 0))
sea.data.transform(__import__("mathutils").Matrix.Rotation(-math.pi / 2, 4, "X"))  # modeled upright, turned level
sea.data.materials.append(material_of("M2", lambda tree: add_node(tree, "BsdfGlass").outputs[0]))
def leafy(tree):
    clear, leaf = (add_node(tree, kind).outputs[0] for kind in ("BsdfTransparent", "BsdfPrincipled"))
    return add_node(tree, "MixShader", {1: clear, 2: leaf}).outputs[0]
plane("Leaf mat", 30, (0, 0, 8)).data.materials.append(material_of("M4", leafy))
deep = cube("Ocean", 40, (0, 0, -9))
deep.scale.z = 0.4
murk = material_of("M5", lambda tree: add_node(tree, "VolumeAbsorption").outputs[0], socket="Volume")
for wet in (deep, cube("Mist", 90, (0, 0, 0))):
    wet.data.materials.append(murk)
bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/dressed.blend")

# glTF: KHR_materials_transmission; without the wide flat sheet of murk, which it cannot hold.
for name in ("Ocean", "Mist", "Leaf mat"):
    bpy.data.objects.remove(bpy.data.objects[name])
bpy.ops.export_scene.gltf(filepath=f"{folder}/dressed.glb", export_apply=True)

# A lake within the ground's mesh, a steep waterfall in that of another, and ground all of which wears water.
terrain = begin()
terrain.name = "Terrain"
terrain.modifiers.new("t", "TRIANGULATE")
for name in ("Grass", "Lake water"):
    terrain.data.materials.append(principled(name, gray))
for face in terrain.data.polygons:
    x, y, _ = face.center
    face.material_index = 7 if x > 20 and y > 0 else 0  # beyond the last slot, as the last is worn
cliff = plane("North terrain", 40, (0, -60, 9), cells=4)
for name in ("Grass", "Falling water"):
    cliff.data.materials.append(principled(name, gray))
for vertex in cliff.data.vertices:
    vertex.co.z = 4 * vertex.co.x if vertex.co.x > 9 else 0
for face in cliff.data.polygons:
    face.material_index = int(face.center.x > 9)
bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/worn.blend")
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("water")
    subprocess.run([sys.executable, "-c", MADE, str(folder)], check=True, capture_output=True)
    return folder


def read(folder: Path, name: str, **patterns: tuple[str, ...]) -> tuple[Exported, Scenery]:
    exported = export(folder / name, folder, kind="scenery", options=replace(Options(), **patterns))
    return exported, load_scenery(exported.bundle)


def water_of(scenery: Scenery) -> list[str]:
    return sorted({scenery.instance_names[i] for i in np.flatnonzero(scenery.instance_is_water)})


@pytest.mark.blender
def test_ground_by_shape_and_water_by_name_also_in_instances(folder: Path) -> None:
    exported, scenery = read(folder, "named.blend")
    assert scenery.ground_names == ("Plane.003",)
    assert any(doubt.startswith("taken as ground: 'Plane.003', by shape") for doubt in exported.report.doubts)
    assert water_of(scenery) == ["Teich", "Wasserfläche"]
    water = scenery.water()
    assert water is not None
    z = Terrain(water).top_hits([[0.0, 40.0], [40.0, 40.0], [-40.0, -40.0], [79.0, 79.0]]).z
    assert np.allclose(z, [5.0, 6.0, -1.0, np.nan], equal_nan=True)


@pytest.mark.blender
@pytest.mark.parametrize("name", ["dressed.blend", "dressed.glb"])
def test_water_by_material_excludes_leaves(folder: Path, name: str) -> None:
    _, scenery = read(folder, name)
    assert scenery.ground_names == ("Plane",)
    assert water_of(scenery) == sorted(["Flat.001", "Upright", *(["Ocean"] if name.endswith("blend") else [])])
    _, none = read(folder, name, water=())
    assert water_of(none) == []


@pytest.mark.blender
def test_faces_of_the_ground_with_a_water_material_are_water(folder: Path) -> None:
    exported, scenery = read(folder, "worn.blend")
    assert water_of(scenery) == ["Terrain"]
    water, ground = scenery.water(), scenery.ground
    assert water is not None
    assert ground is not None
    xy = [[50.0, 50.0], [-50.0, 50.0], [50.0, -50.0]]
    assert np.isfinite(Terrain(water).top_hits(xy).z).tolist() == [True, False, False]
    assert np.isfinite(Terrain(ground).top_hits(xy).z).tolist() == [False, True, True]
    assert scenery.ground_names == ("Terrain", "North terrain")
    doubts = exported.report.doubts
    assert "taken as water: the faces of 'Terrain' that wear water; if they are ground, set water = []" in doubts
    assert any(doubt.startswith("'North terrain' is ground and wears 'Falling water'") for doubt in doubts)
    _, dry = read(folder, "worn.blend", water=())
    assert dry.water() is None
    assert np.isfinite(Terrain(dry.ground).top_hits(xy).z).all()


@pytest.mark.blender
@pytest.mark.parametrize(
    ("drop", "gone"),
    [
        pytest.param(("bed of oaks",), {"Bed of oaks", "Oak"}, id="what scatters, and so what it scatters"),
        pytest.param(("collection:kept",), {"Teich"}, id="a collection that is instanced"),
    ],
)
def test_dropped_objects_are_neither_planned_nor_rendered(folder: Path, drop: tuple[str, ...], gone: set[str]) -> None:
    _, all_of_it = read(folder, "named.blend")
    exported, scenery = read(folder, "named.blend", drop=drop)
    kept = {*scenery.ground_names, *scenery.instance_names}
    assert {*all_of_it.ground_names, *all_of_it.instance_names} - kept == gone
    assert_what_is_planned_is_rendered(folder / "named.blend", exported, scenery)
