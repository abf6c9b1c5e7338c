"""Make cards whose materials read something of their objects, draw and read them, and draw their tidy twin twice.

Run as a script with a folder to write into: pictures.npz has the pictures, doubts.json what reading doubts.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np

from hulldown.blender.add_nodes import add_node
from hulldown.blender.light_pictures import render_light, set_light_at_pixel_centers
from hulldown.reading.blender import reader
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import reader_job
from hulldown.render.blender import cycles
from hulldown.render.blender.object_index import ONE_RAY
from hulldown.render.blender.scene import append_twin_and_materials
from hulldown.tests.builders.blend_parts import empty, fresh, mesh, place, save

COPIES = 9  # enough to be drawn by one object


def card(name, kind, output, copies=1, **settings):
    made = bpy.data.materials.new(name)
    tree = made.node_tree
    tree.nodes.clear()
    given = add_node(tree, kind, **settings).outputs[output]
    shown = add_node(tree, "Emission", {0: given}).outputs[0]
    tree.links.new(shown, add_node(tree, "OutputMaterial").inputs["Surface"])
    data = mesh(name, [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)], [(0, 1, 2, 3)])
    data.materials.append(made)
    for _ in range(copies):
        place(name, data, (len(bpy.data.objects), 0, 0))


def picture(scene):
    """The first cards, one pixel each."""
    lens = bpy.data.cameras.new("camera")
    count = COPIES + 2
    lens.type, lens.ortho_scale = "ORTHO", count
    scene.camera = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(scene.camera)
    scene.camera.location, scene.camera.rotation_euler = (count / 2, -5, 0.5), (np.pi / 2, 0, 0)
    scene.render.resolution_x, scene.render.resolution_y = count * 4, 4
    cycles.configure_scene(scene, ONE_RAY, device="CPU")
    set_light_at_pixel_centers(scene)
    return render_light(scene)[1, 1::4, 0]


def twin(path):
    """A scene with the twin, beside what is already there."""
    scene = bpy.data.scenes.new("shown")
    scene.collection.children.link(append_twin_and_materials(str(path))[0])
    return scene


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    fresh()
    card("one", "ObjectInfo", "Random", copies=2)
    card("many", "ObjectInfo", "Random", copies=COPIES)
    card("index", "ObjectInfo", "Object Index")
    card("plain", "NewGeometry", "Position")
    card("tone", "Attribute", "Color", attribute_type="INSTANCER", attribute_name="tone")
    card("vertex color", "Attribute", "Color", attribute_name="tone")
    card("particle", "ParticleInfo", "Age")
    card("placed", "TexCoord", "Object", object=empty("place"))
    card("own", "TexCoord", "Object")
    save(folder / "cards.blend")
    pictures = [picture(bpy.context.scene)]
    found = {}
    for up in ("z", "y"):
        out = folder / up
        out.mkdir()
        job = reader_job(folder / "cards.blend", out, kind="scenery", options=Options(up=up))
        found[up] = [doubt.text for doubt in reader.run_asset_job(job).report.doubts]
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    pictures += [picture(twin(folder / "z" / "tidy.blend")) for _ in range(2)]
    np.savez(folder / "pictures.npz", *pictures)
    (folder / "doubts.json").write_text(json.dumps(found))
