"""Build asset files that each try to read one file outside their folder, or to write there; run in Blender.

``python attack_files.py build ASSETS SECRET TARGET`` writes ASSETS/<case>.<suffix>, which refers to SECRET/<case>* or
would write below TARGET or next to itself, and ASSETS/all/everything.blend, a scenery with all attacks.
``python attack_files.py open FILE...`` opens and renders files as Blender does, without hulldown's precautions.
"""

import json
import os
import sys
from functools import partial
from pathlib import Path

import bpy
import matplotlib
import numpy as np
from PIL import Image

from hulldown.blender.add_nodes import add_node
from hulldown.blender.tidy_properties import PART_PROPERTY, REST_PROPERTY
from hulldown.tests.builders.blend_parts import collection, cube, fresh, from_library, link, place, save
from hulldown.tests.builders.node_trees import node_group, shader_of, textured, write_picture

FONT = Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"
USD = partial(bpy.ops.wm.usd_export, root_prim_path="/scene")
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def picture(path):
    return write_picture(path, np.full((8, 8, 3), (1.0, 0.0, 1.0)))


def text(path, lines):
    path.write_text(lines)
    return path


def beside(path):
    """A link next to the asset that leads to a file."""
    here = Path(bpy.data.filepath).with_name(f"beside{path.suffix}")
    here.symlink_to(path)
    return here


def skinned(path, source="FILE"):
    """A body with the colors of a picture."""
    image = bpy.data.images.load(str(path))
    image.source = source
    cube().data.materials.append(textured("m", image))
    return image


def importing(kind, path):
    """A body whose geometry nodes import a file; its shape depends on the file's content."""
    group, given, result = node_group("Geometry")
    nodes, link = group.nodes, group.links.new
    join, node = nodes.new("GeometryNodeJoinGeometry"), nodes.new(f"GeometryNodeImport{kind}")
    node.inputs["Path"].default_value = str(path)
    link(given[0], join.inputs[0])
    made = node.outputs[0]
    if kind == "Text":
        length, grid = nodes.new("FunctionNodeStringLength"), nodes.new("GeometryNodeMeshGrid")
        link(made, length.inputs[0])
        link(length.outputs[0], grid.inputs["Vertices X"])
        made = grid.outputs[0]
    elif kind == "CSV":
        instance, real = nodes.new("GeometryNodeInstanceOnPoints"), nodes.new("GeometryNodeRealizeInstances")
        link(made, instance.inputs["Points"])
        link(nodes.new("GeometryNodeMeshCube").outputs[0], instance.inputs["Instance"])
        link(instance.outputs[0], real.inputs[0])
        made = real.outputs[0]
    link(made, join.inputs[0])
    link(join.outputs[0], result[0])
    cube().modifiers.new("nodes", "NODES").node_group = group


def library(path):
    """Link an object of another file."""
    loot = from_library(path, "objects", "Loot")
    cube()
    link(loot)


def relative(secret):
    skinned(picture(secret / "relative.png")).filepath = bpy.path.relpath(str(secret / "relative.png"))


def udim(secret):
    picture(secret / "udim.1001.png")
    skinned(secret / "udim.1001.png", "TILED").filepath = str(secret / "udim.<UDIM>.png")


def movie(secret):
    Image.new("RGB", (8, 8)).save(secret / "movie.gif")
    skinned(secret / "movie.gif", "MOVIE")


def displaced(secret):
    modifier = cube().modifiers.new("displaced", "DISPLACE")
    modifier.texture = bpy.data.textures.new("t", "IMAGE")
    modifier.texture.image = bpy.data.images.load(str(picture(secret / "displaced.png")))


def font(secret):
    cube()
    (secret / "font.ttf").write_bytes(FONT.read_bytes())
    bpy.ops.object.text_add()
    bpy.context.object.data.font = bpy.data.fonts.load(str(secret / "font.ttf"))


def volume(secret):
    cube()
    (secret / "volume.vdb").write_bytes(b" BDV" + bytes(100))
    data = bpy.data.volumes.new("smoke")
    data.filepath = str(secret / "volume.vdb")
    place("smoke", data)


def cached(path, export, inside):
    """A body whose shape is in a cache, under this name."""
    obj = cube()
    export(filepath=str(path))
    bpy.ops.cachefile.open(filepath=str(path))
    modifier = obj.modifiers.new("cached", "MESH_SEQUENCE_CACHE")
    modifier.cache_file, modifier.object_path = bpy.data.cache_files[0], inside


def ies(secret):
    text(secret / "ies.ies", "IESNA:LM-63-2002\nTILT=NONE\n1 100 1 2 1 1 1 0 0 0\n1 1 10\n0 90\n0\n1 1\n")
    material = bpy.data.materials.new("m")
    cube().data.materials.append(material)
    node = add_node(material.node_tree, "TexIES", mode="EXTERNAL", filepath=str(secret / "ies.ies"))
    material.node_tree.links.new(node.outputs[0], shader_of(material).inputs["Base Color"])


# By name, what builds it with a file of that name in a folder.
READERS = {
    "linked": lambda secret: library(secret / "linked.blend"),
    "linked_by_a_link": lambda secret: library(beside(secret / "linked_by_a_link.blend")),
    "image": lambda secret: skinned(picture(secret / "image.png")),
    "relative": relative,
    "image_by_a_link": lambda secret: skinned(beside(picture(secret / "image_by_a_link.png"))),
    **{"udim": udim, "movie": movie, "displaced": displaced, "font": font, "volume": volume, "ies": ies},
    "alembic": lambda secret: cached(secret / "alembic.abc", bpy.ops.wm.alembic_export, "/Body/Body"),
    "usd": lambda secret: cached(secret / "usd.usdc", USD, "/scene/Body/Body"),
    "import_text": lambda secret: importing("Text", text(secret / "import_text.txt", "loot")),
    "import_csv": lambda secret: importing("CSV", text(secret / "import_csv.csv", "position:3,a\n1,2\n")),
    "import_obj": lambda secret: importing("OBJ", text(secret / "import_obj.obj", TRIANGLE)),
}


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


def outputs(target):
    cube()
    render = bpy.context.scene.render
    render.filepath = str(target / "picture")
    render.use_render_cache = True
    tree = bpy.data.node_groups.new("out", "CompositorNodeTree")
    bpy.context.scene.compositing_node_group = tree
    node = tree.nodes.new("CompositorNodeOutputFile")
    node.directory = str(target / "composited")


WRITERS = {case.__name__: case for case in (particles, paint, fluid, outputs)} | {"nothing": lambda target: cube()}


def as_vehicle():
    """Move all objects into a collection, as in prepared vehicles."""
    vehicle = collection("A vehicle")
    for obj in [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]:
        vehicle.objects.link(obj)
        obj[PART_PROPERTY], obj[REST_PROPERTY] = 0, np.eye(4).ravel().tolist()


def gltf(path, owner, uri):
    """A glTF file whose image or buffer is elsewhere."""
    fresh()
    skinned(picture(path.with_suffix(".png")))
    bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLTF_SEPARATE")
    data = json.loads(path.read_text())
    data[owner][0]["uri"] = uri
    path.write_text(json.dumps(data))


def files_of_other_formats(assets, secret):
    up = os.path.relpath(secret, assets)
    gltf(assets / "gltf_picture.gltf", "images", f"{up}/{picture(secret / 'gltf_picture.png').name}")
    gltf(assets / "gltf_absolute.gltf", "images", str(picture(secret / "gltf_absolute.png")))
    gltf(assets / "gltf_points.gltf", "buffers", f"{up}/gltf_points.bin")
    (assets / "gltf_points.bin").rename(secret / "gltf_points.bin")
    for name in ("obj_material", "obj_picture", "fbx"):
        fresh()
        skinned(picture(secret / f"{name}.png"))
        if name == "fbx":
            bpy.ops.export_scene.fbx(filepath=str(assets / "fbx.fbx"), path_mode="RELATIVE")
        else:
            bpy.ops.wm.obj_export(filepath=str(assets / f"{name}.obj"), path_mode="RELATIVE")
    (assets / "obj_material.mtl").rename(secret / "obj_material.mtl")
    there = (assets / "obj_material.obj").read_text()
    text(assets / "obj_material.obj", there.replace("mtllib ", f"mtllib {up}/"))


def build(assets, secret, target):
    for name in ("linked", "linked_by_a_link"):
        fresh()
        cube("Loot")
        save(secret / f"{name}.blend")
    attacks = READERS | WRITERS
    for name, attack in attacks.items():
        path = assets / f"{name}.blend"
        fresh()
        save(path)  # relative paths need it
        attack(target if name in WRITERS else secret)
        if name in WRITERS:
            as_vehicle()
        save(path, relative_remap=False)
    files_of_other_formats(assets, secret)
    fresh()
    save(assets / "all/everything.blend")
    for name, attack in attacks.items():
        if name not in ("alembic", "usd", "fluid"):  # those export the whole scene, or crash with others
            attack(target if name in WRITERS else secret)
    for obj in bpy.data.objects:
        if not obj.library:
            obj.name = "thing"  # a body would make the file a vehicle
    bpy.ops.mesh.primitive_grid_add(size=80.0, x_subdivisions=20, y_subdivisions=20)
    bpy.context.object.name = "ground"
    save(assets / "all/everything.blend", relative_remap=False)
    fresh()
    importing("Text", text(assets / "notes.txt", "the user's own notes"))
    importing("Text", "/etc/passwd")
    group = bpy.context.object.modifiers[0].node_group
    group.name = "linked nodes"
    bpy.data.libraries.write(str(assets / "all/nodes.blend"), {group}, fake_user=True)
    bpy.data.node_groups.remove(group)
    again = from_library(assets / "all/nodes.blend", "node_groups", "linked nodes")
    bpy.context.object.modifiers[0].node_group = again
    importing("CSV", text(assets / "table.csv", "position:3,a\n1,2\n5,6\n"))
    save(assets / "all/neighbors.blend", relative_remap=False)
    write_picture(assets / "sky.exr", np.linspace(0.1, 1.0, 3 * 64 * 32).reshape(32, 64, 3))


def open_it(path):
    """Open a file like a user who trusts it."""
    fresh()
    importers = {".gltf": bpy.ops.import_scene.gltf, ".obj": bpy.ops.wm.obj_import, ".fbx": bpy.ops.import_scene.fbx}
    if path.suffix in importers:
        importers[path.suffix](filepath=str(path))
    else:
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
    scene = bpy.context.scene
    scene.render.engine, scene.render.use_compositing, scene.render.use_sequencer = "CYCLES", False, False
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.cycles.samples = 1
    scene.camera = place("camera", bpy.data.cameras.new("camera"), (0.0, 0.0, 9.0))
    for frame in (1, 2):
        scene.frame_set(frame)
    bpy.ops.render.render()
    for image in bpy.data.images:
        len(image.pixels)


if __name__ == "__main__":
    what, *paths = sys.argv[1:]
    if what == "build":
        build(*map(Path, paths))
    else:
        for each in paths:
            open_it(Path(each))
    sys.stdout.flush()
    os._exit(0)
