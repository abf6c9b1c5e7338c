"""Build asset files that each try to read one file outside their folder, or to write there; run in Blender.

``python attack_files.py build ASSETS SECRET TARGET`` writes ASSETS/<case>.<suffix>, which refers to SECRET/<case>*, and
ASSETS/all/everything.blend, a scenery with all attacks. ``python attack_files.py open FILE...`` opens and
renders files as Blender does, without hulldown's precautions.
"""

import json
import os
import struct
import sys
from pathlib import Path

import bpy
import matplotlib
import numpy as np
from writing_blends import CASES as WRITERS
from writing_blends import cube, sky

FONT = Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
CORNERS = CUBE[np.concatenate([QUADS[:, :3], QUADS[:, [0, 2, 3]]])].reshape(-1, 3)


def picture(path, color=(1.0, 0.0, 1.0)):
    image = bpy.data.images.new("made", 8, 8)
    image.pixels.foreach_set(np.tile(np.float32([*color, 1.0]), 64))
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)
    return path


def text(path, lines="v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"):
    path.write_text(lines)
    return path


def material(node):
    """A node of this kind, which colors a new material of the active object."""
    made = bpy.data.materials.new("m")
    nodes = made.node_tree.nodes
    added = nodes.new(node)
    if added.outputs:
        made.node_tree.links.new(added.outputs[0], nodes["Principled BSDF"].inputs["Base Color"])
    bpy.context.object.data.materials.append(made)
    return added


def textured(path, source="FILE"):
    cube()
    image = bpy.data.images.load(str(path))
    image.source = source
    material("ShaderNodeTexImage").image = image
    return image


def importing(kind, path):
    """A body whose geometry nodes import a file; its shape depends on the file's content."""
    obj = cube()
    tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    nodes, link = tree.nodes, tree.links.new
    given, join, out = (nodes.new(n) for n in ("NodeGroupInput", "GeometryNodeJoinGeometry", "NodeGroupOutput"))
    node = nodes.new(f"GeometryNodeImport{kind}")
    node.inputs["Path"].default_value = str(path)
    link(given.outputs[0], join.inputs[0])
    made = node.outputs[0]
    if kind == "Text":
        length, grid = nodes.new("FunctionNodeStringLength"), nodes.new("GeometryNodeMeshGrid")
        link(made, length.inputs[0])
        link(length.outputs[0], grid.inputs["Vertices X"])
        made = grid.outputs[0]
    elif kind == "CSV":
        instance, mesh = nodes.new("GeometryNodeInstanceOnPoints"), nodes.new("GeometryNodeMeshCube")
        real = nodes.new("GeometryNodeRealizeInstances")
        link(made, instance.inputs["Points"])
        link(mesh.outputs[0], instance.inputs["Instance"])
        link(instance.outputs[0], real.inputs[0])
        made = real.outputs[0]
    link(made, join.inputs[0])
    link(join.outputs[0], out.inputs[0])
    obj.modifiers.new("nodes", "NODES").node_group = tree


def library(path, link=True):
    """Link an object of another file."""
    with bpy.data.libraries.load(str(path), link=link) as (_, wanted):
        wanted.objects = ["Loot"]
    cube()
    bpy.context.scene.collection.objects.link(wanted.objects[0])


def linked(secret):
    library(secret / "linked.blend")


def linked_by_a_link(secret):
    """The library is a symbolic link next to the asset."""
    here = Path(bpy.data.filepath).parent / "beside.blend"
    here.symlink_to(secret / "linked_by_a_link.blend")
    library(here)


def image(secret):
    textured(picture(secret / "image.png"))


def relative(secret):
    textured(picture(secret / "relative.png")).filepath = bpy.path.relpath(str(secret / "relative.png"))


def image_by_a_link(secret):
    here = Path(bpy.data.filepath).parent / "beside.png"
    here.symlink_to(picture(secret / "image_by_a_link.png"))
    textured(here)


def udim(secret):
    picture(secret / "udim.1001.png")
    textured(secret / "udim.1001.png", "TILED").filepath = str(secret / "udim.<UDIM>.png")


def movie(secret):
    textured(movie_file(secret / "movie.avi"), "MOVIE")


def displaced(secret):
    cube()
    modifier = bpy.context.object.modifiers.new("displaced", "DISPLACE")
    modifier.texture = bpy.data.textures.new("t", "IMAGE")
    modifier.texture.image = bpy.data.images.load(str(picture(secret / "displaced.png")))


def movie_file(path):
    """An uncompressed AVI of one picture."""
    frame = bytes(8 * 8 * 3)
    strf = struct.pack("<IiiHHIIiiII", 40, 8, 8, 1, 24, 0, len(frame), 0, 0, 0, 0)
    strh = struct.pack("<4s4sIHHIIIIIIIIHHHH", b"vids", b"DIB ", 0, 0, 0, 0, 1, 25, 0, 1, len(frame), 0, 0, 0, 0, 8, 8)
    avih = struct.pack("<14I", 40000, 0, 0, 0x10, 1, 0, 1, len(frame), 8, 8, 0, 0, 0, 0)

    def chunk(name, data):
        return name + struct.pack("<I", len(data)) + data

    streams = chunk(b"LIST", b"strl" + chunk(b"strh", strh) + chunk(b"strf", strf))
    body = b"AVI " + chunk(b"LIST", b"hdrl" + chunk(b"avih", avih) + streams)
    body += chunk(b"LIST", b"movi" + chunk(b"00db", frame)) + chunk(b"idx1", struct.pack("<4sIII", b"00db", 16, 4, 192))
    path.write_bytes(chunk(b"RIFF", body))
    return path


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
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("smoke", data))


def cached(secret, suffix, export, inside):
    """A body whose shape comes from a cache of this kind."""
    obj = cube()
    export(filepath=str(secret / f"{inside}{suffix}"))
    bpy.ops.cachefile.open(filepath=str(secret / f"{inside}{suffix}"))
    modifier = obj.modifiers.new("cached", "MESH_SEQUENCE_CACHE")
    modifier.cache_file = bpy.data.cache_files[0]
    modifier.object_path = "/Body/Body" if suffix == ".abc" else "/root/Body/Body"


def alembic(secret):
    cached(secret, ".abc", bpy.ops.wm.alembic_export, "alembic")


def usd(secret):
    cached(secret, ".usdc", bpy.ops.wm.usd_export, "usd")


def ies(secret):
    cube()
    text(secret / "ies.ies", "IESNA:LM-63-2002\nTILT=NONE\n1 100 1 2 1 1 1 0 0 0\n1 1 10\n0 90\n0\n1 1\n")
    node = material("ShaderNodeTexIES")
    node.mode, node.filepath = "EXTERNAL", str(secret / "ies.ies")


def import_text(secret):
    importing("Text", text(secret / "import_text.txt", "loot"))


def import_csv(secret):
    importing("CSV", text(secret / "import_csv.csv", "position:3,a\n1,2\n"))


def import_obj(secret):
    importing("OBJ", text(secret / "import_obj.obj"))


def import_stl(secret):
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    importing("STL", text(secret / "import_stl.stl", f"solid loot\n{facet}endsolid loot\n"))


def import_ply(secret):
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    importing("PLY", text(secret / "import_ply.ply", head + faces))


def import_vdb(secret):
    (secret / "import_vdb.vdb").write_bytes(b" BDV" + bytes(100))
    importing("VDB", secret / "import_vdb.vdb")


READERS = (
    *(linked, linked_by_a_link, image, relative, image_by_a_link, udim, movie, displaced, font, volume),
    *(alembic, usd, ies, import_text, import_csv, import_obj, import_stl, import_ply, import_vdb),
)


def gltf(path, secret, uri, *, buffer=False):
    """A glTF file whose picture or points are elsewhere."""
    inside = CORNERS.tobytes() + np.ascontiguousarray(CORNERS[:, :2]).tobytes()
    (path.with_suffix(".bin")).write_bytes(inside)
    data = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": "Body"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}], "images": [{"uri": path.with_suffix(".png").name if buffer else uri}],
        "buffers": [{"uri": uri if buffer else path.with_suffix(".bin").name, "byteLength": len(inside)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 432},
            {"buffer": 0, "byteOffset": 432, "byteLength": 288},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 36, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": 5126, "count": 36, "type": "VEC2"},
        ],
    }  # fmt: skip
    picture(path.with_suffix(".png"))
    if path.suffix == ".glb":
        packed = json.dumps(data).encode()
        packed += b" " * (-len(packed) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 20 + len(packed))
        path.write_bytes(head + struct.pack("<I4s", len(packed), b"JSON") + packed)
    else:
        path.write_text(json.dumps(data))
    return inside


def files_of_other_formats(assets, secret):
    up = os.path.relpath(secret, assets)
    gltf(assets / "gltf_relative.gltf", secret, f"{up}/{picture(secret / 'gltf_relative.png').name}")
    gltf(assets / "gltf_absolute.gltf", secret, str(picture(secret / "gltf_absolute.png")))
    inside = gltf(assets / "gltf_points.gltf", secret, f"{up}/gltf_points.bin", buffer=True)
    (secret / "gltf_points.bin").write_bytes(inside)
    gltf(assets / "glb.glb", secret, f"{up}/{picture(secret / 'glb.png').name}")
    body = "".join("v {} {} {}\n".format(*corner) for corner in CUBE) + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl loot\n"
    body += "".join("f {}/1 {}/2 {}/3 {}/4\n".format(*quad) for quad in QUADS + 1)
    text(assets / "obj_material.obj", f"mtllib {up}/obj_material.mtl\n" + body)
    text(secret / "obj_material.mtl", "newmtl loot\nKd 1 0 1\n")
    text(assets / "obj_picture.obj", "mtllib obj_picture.mtl\n" + body)
    text(assets / "obj_picture.mtl", f"newmtl loot\nmap_Kd {up}/{picture(secret / 'obj_picture.png').name}\n")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    textured(picture(secret / "fbx.png"))
    bpy.ops.export_scene.fbx(filepath=str(assets / "fbx.fbx"), path_mode="RELATIVE")


def build(assets, secret, target):
    for name in ("linked", "linked_by_a_link"):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        cube("Loot")
        bpy.ops.wm.save_as_mainfile(filepath=str(secret / f"{name}.blend"))
    attacks = [(case, secret) for case in READERS] + [(case, target) for case in WRITERS.values()]
    for case, aim in attacks:
        path = str(assets / f"{case.__name__}.blend")
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.save_as_mainfile(filepath=path)  # relative paths need it
        case(aim)
        bpy.ops.wm.save_as_mainfile(filepath=path, relative_remap=False)
    files_of_other_formats(assets, secret)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    (assets / "all").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(assets / "all/everything.blend"))
    for case, aim in attacks:
        if case.__name__ not in ("alembic", "usd", "fluid"):  # those export the whole scene, or crash with others
            case(aim)
    for obj in bpy.data.objects:
        if not obj.library:
            obj.name = "thing"  # a body would make the file a vehicle
    bpy.ops.mesh.primitive_grid_add(size=80.0, x_subdivisions=20, y_subdivisions=20)
    bpy.context.object.name = "ground"
    bpy.ops.wm.save_as_mainfile(filepath=str(assets / "all/everything.blend"), relative_remap=False)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    importing("Text", text(assets / "notes.txt", "the user's own notes"))
    importing("Text", "/etc/passwd")
    group = bpy.context.object.modifiers[0].node_group
    group.name = "linked nodes"
    bpy.data.libraries.write(str(assets / "all/nodes.blend"), {group}, fake_user=True)
    bpy.data.node_groups.remove(group)
    with bpy.data.libraries.load(str(assets / "all/nodes.blend"), link=True) as (_, wanted):
        wanted.node_groups = ["linked nodes"]
    bpy.context.object.modifiers[0].node_group = wanted.node_groups[0]
    importing("CSV", text(assets / "table.csv", "position:3,a\n1,2\n5,6\n"))
    bpy.ops.wm.save_as_mainfile(filepath=str(assets / "all/neighbors.blend"), relative_remap=False)
    sky(assets / "sky.exr")


def open_it(path):
    """Open a file like a user who trusts it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    ways = {
        ".gltf": "import_scene.gltf",
        ".glb": "import_scene.gltf",
        ".obj": "wm.obj_import",
        ".fbx": "import_scene.fbx",
    }
    if path.suffix in ways:
        folder, name = ways[path.suffix].split(".")
        getattr(getattr(bpy.ops, folder), name)(filepath=str(path))
    else:
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
    scene = bpy.context.scene
    scene.render.engine, scene.render.use_compositing, scene.render.use_sequencer = "CYCLES", False, False
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.cycles.samples = 1
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.location = (0.0, 0.0, 9.0)
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
