"""Build .blend files that are odd in one way each; run in Blender, with a folder to write into."""

import math
import os
import sys
from pathlib import Path

import bpy

from hulldown.tests.blend_parts import collection, cube, fresh, from_library, link, save
from hulldown.tests.node_trees import node_group


def nan_location(_):
    cube().location.x = math.nan


def nan_empty(_):
    cube()
    bpy.ops.object.empty_add()
    bpy.context.object.name = "pivot"
    bpy.context.object.location.z = math.nan


def squashed_gun(_):
    cube()
    turret, gun = cube("Turret"), cube("Gun")
    turret.location.z, gun.location.z, gun.scale = 2.0, 2.0, (0.0, 0.0, 0.0)


def far_location(_):
    cube().location.y = 1e20


def nan_vertices(_):
    cube().data.vertices[0].co.x = math.nan


def haired(count):
    (body := cube()).modifiers.new("Hair", "PARTICLE_SYSTEM")
    body.data.materials.append(bpy.data.materials.new("Fur"))
    body.particle_systems[0].settings.type, body.particle_systems[0].settings.count = "HAIR", count
    return body


def nan_strands(_):
    """Strands are read before their mesh."""
    haired(3).location.x = math.nan


def bald(_):
    haired(0)


def furry(_):
    haired(3)


def no_known_tree(_):
    """Nodes of a kind that Blender doesn't know."""
    cube().data.materials.append(bpy.data.materials.new("Plain"))


def names(_):
    obj = cube("Nxmd")
    obj.data.name = "Dxta"
    obj.data.materials.append(bpy.data.materials.new("Mxterial"))
    collection("Cxllection").objects.link(obj)
    obj.modifiers.new("Pxrticles", "PARTICLE_SYSTEM")
    obj.particle_systems[0].name = "Pxrticles"
    bpy.context.scene.name = "Scxne"
    bpy.context.scene.view_layers[0].name = "Lxyer"


def empty_scene(_):
    """Everything is in a scene that isn't the active one."""
    cube()
    bpy.context.window.scene = bpy.data.scenes.new("Empty")


def instances(_):
    group, _, result = node_group("Geometry")
    points, on_points = group.nodes.new("GeometryNodePoints"), group.nodes.new("GeometryNodeInstanceOnPoints")
    points.inputs["Count"].default_value = 100_000_000
    group.links.new(points.outputs[0], on_points.inputs["Points"])
    group.links.new(group.nodes.new("GeometryNodeMeshCube").outputs[0], on_points.inputs["Instance"])
    group.links.new(on_points.outputs[0], result[0])
    modifier = cube().modifiers.new("many", "NODES")
    modifier.show_viewport = False  # saving would make all instances
    modifier.node_group = group


def library(folder):
    """An object linked from a file that will be a FIFO."""
    cube("Linked")
    save(folder / "lib.blend")
    fresh()
    cube()
    link(from_library(folder / "lib.blend", "objects", "Linked", relative=True))


def font(folder):
    bpy.ops.object.text_add()
    source = next(Path(bpy.utils.system_resource("DATAFILES")).rglob("*.woff2"))
    (folder / "font.woff2").write_bytes(source.read_bytes())
    bpy.context.object.data.font = bpy.data.fonts.load(str(folder / "font.woff2"))


CASES = (
    *(nan_location, nan_empty, far_location, nan_vertices, nan_strands, bald, furry),
    *(squashed_gun, no_known_tree, names, empty_scene, instances, library, font),
)
COMPRESSED = (library,)  # too


def main(folder):
    for case in CASES:
        fresh()
        case(folder)
        for compress in (False, True) if case in COMPRESSED else (False,):
            path = folder / f"{case.__name__}{'_compressed' * compress}.blend"
            save(path, compress=compress, relative_remap=False)
    for name in ("lib.blend", "font.woff2"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
    odd = (folder / "names.blend").read_bytes()
    for name in (b"Nxmd", b"Dxta", b"Mxterial", b"Cxllection", b"Pxrticles", b"Scxne", b"Lxyer"):
        assert name in odd
        odd = odd.replace(name, name.replace(b"x", b"\xfc"))
    (folder / "names.blend").write_bytes(odd)
    path = folder / "no_known_tree.blend"
    path.write_bytes(path.read_bytes().replace(b"ShaderNodeTree", b"ShaderNodeTrex"))


main(Path(sys.argv[1]))
