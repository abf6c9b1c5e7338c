"""Build .blend files that write when Blender evaluates them, and open them; run in Blender.

``python writing_blends.py build FOLDER TARGET`` writes FOLDER/<case>.blend, each of which would write below TARGET or
next to itself; it can be rendered as a scenery, and appended as a vehicle. FOLDER/sky.exr is an HDRI.
``python writing_blends.py open FILE`` opens one as Blender does, without hulldown's precautions.
"""

import os
import sys
from pathlib import Path

import bpy
import numpy as np

from hulldown.reading.blender.tidy_properties import PART, REST
from hulldown.tests.blend_parts import collection, fresh, save
from hulldown.tests.node_trees import write_picture


def cube(name="Body"):
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    bpy.context.object.name = name
    return bpy.context.object


def particles(target):
    obj = cube()
    obj.modifiers.new("dust", "PARTICLE_SYSTEM")
    system = obj.particle_systems[0]
    system.settings.count, system.settings.frame_start = 10, -10
    system.point_cache.name = "dust"
    system.point_cache.use_disk_cache = True


def paint(target):
    canvas = cube().modifiers.new("paint", "DYNAMIC_PAINT")
    canvas.ui_type = "CANVAS"
    bpy.ops.dpaint.type_toggle(type="CANVAS")
    surface = canvas.canvas_settings.canvas_surfaces[0]
    surface.image_output_path = str(target)
    surface.point_cache.use_disk_cache = True


def fluid(target):
    domain = cube().modifiers.new("water", "FLUID")
    domain.fluid_type = "DOMAIN"
    domain.domain_settings.cache_type = "REPLAY"
    domain.domain_settings.cache_directory = str(target / "fluid")
    domain.domain_settings.resolution_max = 6
    cube("Hull")


def nothing(target):
    cube()


def outputs(target):
    cube()
    render = bpy.context.scene.render
    render.filepath = str(target / "picture")
    render.use_render_cache = True
    tree = bpy.data.node_groups.new("out", "CompositorNodeTree")
    bpy.context.scene.compositing_node_group = tree
    node = tree.nodes.new("CompositorNodeOutputFile")
    node.directory = str(target / "composited")


CASES = {case.__name__: case for case in (particles, paint, fluid, outputs, nothing)}


def as_vehicle():
    """Move all objects into a collection, as in prepared vehicles."""
    vehicle = collection("A vehicle")
    for obj in [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]:
        vehicle.objects.link(obj)
        obj[PART], obj[REST] = 0, np.eye(4).ravel().tolist()


def sky(path):
    write_picture(path, np.linspace(0.1, 1.0, 3 * 64 * 32).reshape(32, 64, 3))


def main(what, *paths):
    if what == "open":
        bpy.ops.wm.open_mainfile(filepath=paths[0], load_ui=False, use_scripts=False)
        for frame in (1, 2, 3):
            bpy.context.scene.frame_set(frame)
        return
    folder, target = map(Path, paths)
    for name, case in CASES.items():
        fresh()
        save(folder / f"{name}.blend")  # otherwise caches can't be on disk
        case(target)
        as_vehicle()
        save(folder / f"{name}.blend")
        sys.stdout.flush()
    sky(folder / "sky.exr")


if __name__ == "__main__":
    main(*sys.argv[1:])
    sys.stdout.flush()
    os._exit(0)  # Blender's fluids crash on exit
