"""Make a row of cards whose materials read something of their objects, and Cycles' pictures of it and of its twins.

Run as a script with a folder to write into: pictures.npz has pictures of the file, of its twin as a scenery, and of its
twin as a vehicle in another place; cards.json has the names of the cards.
"""

import json
import sys
from dataclasses import asdict
from pathlib import Path

import bpy
import numpy as np

from hulldown.assets.bundle import load_scenery, load_vehicle
from hulldown.reading.blender import duplicates, reader
from hulldown.reading.blender.api.add_nodes import add_node
from hulldown.reading.blender.api.light_pictures import rendered, see_pixel_centers
from hulldown.reading.blender.frames import pose
from hulldown.reading.blender.tidy_properties import REST
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import job_for
from hulldown.rendering.blender import cycles
from hulldown.rendering.blender.object_index import ONE_RAY
from hulldown.rendering.blender.scene import appended
from hulldown.tests.blend_parts import collection, cuboid, empty, fresh, instance, mesh, place, save

STEP, PIXELS = 1.2, 12  # units between cards, pixels per unit
CARDS = []
FOLDER = Path(sys.argv[1])
AWAY = np.array([[0.6, -0.8, 0, 31], [0.8, 0.6, 0, -17], [0, 0, 1, 2.5], [0, 0, 0, 1]])  # world_from_file


def material(name, make):
    """Emit what `make` returns for a tree: an output socket."""
    made = bpy.data.materials.new(name)
    tree = made.node_tree
    tree.nodes.clear()
    shown = add_node(tree, "Emission", {0: make(tree)}).outputs[0]
    tree.links.new(shown, add_node(tree, "OutputMaterial").inputs["Surface"])
    return made


def node(kind, output, **settings):
    return lambda tree: add_node(tree, kind, **settings).outputs[output]


def attribute(name, kind):
    return node("Attribute", "Color", attribute_type=kind, attribute_name=name)


def square(name, made):
    data = mesh(name, [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)], [(0, 1, 2, 3)])
    data.uv_layers.new(name="UV")
    data.materials.append(made)
    return data


def card(name, make):
    """A card in the row, of one unit and a little turned, as an object."""
    obj = place(name, square(name, material(name, make)), (STEP * len(CARDS), 0, 0), rot=(0, 0.1, 0))
    CARDS.append(name)
    return obj


def instanced(name, make):
    """A card in the row that is drawn by another object, as an instance; returns that."""
    hidden = collection(f"of {name}")
    bpy.context.view_layer.layer_collection.children[hidden.name].exclude = True
    place(name, square(name, material(name, make)), collection=hidden)
    CARDS.append(name)
    return instance(f"{name} drawn", hidden, (STEP * (len(CARDS) - 1), 0, 0))


def scattered(name, make, count=2):
    """Cards in the row that geometry nodes draw, each with the attribute "tone"."""
    shown = place(f"{name} shown", square(name, material(name, make)), (0, 9, 0))
    shown.hide_render = True
    points = bpy.data.meshes.new(name)
    first = len(CARDS)
    points.from_pydata([(STEP * (first + k) + 0.2, 0, 0.2) for k in range(count)], [], [])
    tones = points.attributes.new("tone", "FLOAT_COLOR", "POINT")
    tones.data.foreach_set("color", np.linspace(0.1, 0.9, 4 * count))
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    given, result = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    info, scatter = tree.nodes.new("GeometryNodeObjectInfo"), tree.nodes.new("GeometryNodeInstanceOnPoints")
    info.inputs["Object"].default_value, info.inputs["As Instance"].default_value = shown, True
    scatter.inputs["Scale"].default_value = (0.6, 0.6, 0.6)
    tree.links.new(given.outputs[0], scatter.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], scatter.inputs["Instance"])
    tree.links.new(scatter.outputs[0], result.inputs[0])
    place(f"{name} carrier", points).modifiers.new("scatter", "NODES").node_group = tree
    CARDS.extend(f"{name} {k}" for k in range(count))


def from_faces(name, make):
    """A card in the row that a face of another object draws."""
    carrier = place(f"{name} carrier", square(name, material(f"{name} carrier", mixed)), (STEP * len(CARDS), 0, 0))
    carrier.instance_type, carrier.show_instancer_for_render = "FACES", False
    tile = mesh(name, [(-0.4, -0.4, 0), (0.4, -0.4, 0), (0.4, 0.4, 0), (-0.4, 0.4, 0)], [(0, 1, 2, 3)])
    tile.materials.append(material(name, make))
    place(f"{name} shown", tile, parent=carrier)
    CARDS.append(name)


def particles(name, make, count=2):
    """Cards in the row that particles draw."""
    shown = place(f"{name} shown", square(name, material(name, make)), (0, 9, 0), rot=(0, 0, 0))
    shown.hide_render = True
    first = len(CARDS)
    points = [(STEP * (first + k) + 0.2, 0, 0.5) for k in range(count)]
    carrier = place(f"{name} carrier", mesh(name, points, []))
    system = carrier.modifiers.new("particles", "PARTICLE_SYSTEM").particle_system.settings
    system.count, system.emit_from, system.use_emit_random = count, "VERT", False
    system.frame_start = system.frame_end = 1
    system.physics_type, system.particle_size = "NO", 0.5
    system.render_type, system.instance_object, system.use_rotation_instance = "OBJECT", shown, True
    CARDS.extend(f"{name} {k}" for k in range(count))


def wrapped(kind, output, **settings):
    """A vector in waves from 0 to 1."""

    def make(tree):
        waves = add_node(tree, "VectorMath", {0: node(kind, output, **settings)(tree)}, operation="SINE").outputs[0]
        half = (0.5, 0.5, 0.5)
        return add_node(tree, "VectorMath", {0: waves, 1: half, 2: half}, operation="MULTIPLY_ADD").outputs[0]

    return make


def mixed(tree):
    """A product of a random number and a property."""
    inputs = {0: node("ObjectInfo", "Random")(tree), 1: attribute("tone", "OBJECT")(tree)}
    return add_node(tree, "Math", inputs, operation="MULTIPLY").outputs[0]


def seventh(tree):
    number = add_node(tree, "ObjectInfo").outputs["Object Index"]
    return add_node(tree, "Math", {0: number, 1: 7.0}, operation="DIVIDE").outputs[0]


def cards():
    thing = place("thing", None, (4.3, 1.0, 0.3), rot=(0.3, 0.2, 0.1), scale=(2, 1, 1))
    card("color", node("ObjectInfo", "Color")).color = (0.2, 0.5, 0.8, 1.0)
    card("index", seventh).pass_index = 3
    card("random", node("ObjectInfo", "Random"))
    card("r\u00e4ndom", node("ObjectInfo", "Random"))
    card("location", node("ObjectInfo", "Location"))
    card("property", attribute("tone", "OBJECT"))["tone"] = (0.7, 0.3, 0.1)
    card("number", attribute("tone", "OBJECT"))["tone"] = 0.4
    card("property of data", attribute("tone", "OBJECT")).data["tone"] = 0.6
    card("built in", attribute("location", "OBJECT"))
    card("lacking", attribute("lacking", "OBJECT"))
    bpy.context.scene["layer tone"] = (0.2, 0.9, 0.4)
    card("view layer", attribute("layer tone", "VIEW_LAYER"))
    card("position", wrapped("NewGeometry", "Position"))
    card("object", wrapped("TexCoord", "Object", object=thing))
    card("own object", wrapped("TexCoord", "Object"))
    card("generated", node("TexCoord", "Generated"))
    stretched = card("stretched", node("TexCoord", "Generated"))
    stretched.modifiers.new("array", "ARRAY").count = 2
    stretched.modifiers[0].use_relative_offset, stretched.modifiers[0].use_constant_offset = False, True
    stretched.modifiers[0].constant_offset_displace = (0.1, 0.0, 0.0)
    alike = square("alike", material("alike", mixed))
    for number in range(3):
        place(f"alike {number}", alike, (STEP * len(CARDS), 0, 0))["tone"] = 0.3 + number // 2
        CARDS.append(f"alike {number}")
    from_faces("of faces", node("TexCoord", "Generated", from_instancer=True))
    from_faces("uv of faces", node("UVMap", "UV", from_instancer=True))
    instanced("instance", node("ObjectInfo", "Random"))
    instanced("instancer", attribute("tone", "INSTANCER"))["tone"] = (0.1, 0.8, 0.6)
    scattered("scattered random", node("ObjectInfo", "Random"))
    scattered("scattered tone", attribute("tone", "INSTANCER"))
    scattered("many", attribute("tone", "INSTANCER"), 9)
    particles("particle", node("ParticleInfo", "Random"))
    particles("place of particle", wrapped("ParticleInfo", "Location"))


def camera(scene, world_from_file):
    """Look at the row, as it is moved with the file."""
    lens = bpy.data.cameras.new("camera")
    lens.type, lens.ortho_scale = "ORTHO", STEP * len(CARDS)
    scene.camera = place("camera", lens, parent=empty("root"))
    at = np.array([[1, 0, 0, lens.ortho_scale / 2], [0, 0, -1, -5], [0, 1, 0, 0.5], [0, 0, 0, 1]])
    at = world_from_file @ at
    lens.ortho_scale *= np.linalg.norm(at[:3, 0])
    at[:3, :3] /= np.linalg.norm(at[:3, 0])
    pose(scene.camera, at)
    scene.render.resolution_x, scene.render.resolution_y = round(STEP * len(CARDS) * PIXELS), PIXELS
    cycles.configure(scene, ONE_RAY, device="CPU")
    see_pixel_centers(scene)
    return rendered(scene)[..., :3]


def twin(kind, **options):
    """The picture of the file's twin."""
    folder = FOLDER / kind
    folder.mkdir()
    told = job_for(FOLDER / "cards.blend", folder, kind=kind, options=Options(**options))
    (folder / "job.json").write_text(json.dumps(asdict(told)))
    reader.main(str(folder / "job.json"))
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    scene, (shown, _) = bpy.context.scene, appended(str(told.file("tidy.blend")))
    scene.collection.children.link(shown)
    if kind == "scenery":
        return camera(scene, load_scenery(folder / "bundle.npz").scenery_from_file)
    world_from_vehicle = AWAY @ np.linalg.inv(load_vehicle(folder / "bundle.npz").vehicle_from_file)
    root = empty("root of parts")
    for obj in shown.objects:
        obj.parent = root
        obj.matrix_basis.identity()
        pose(obj, world_from_vehicle @ np.array(obj[REST]).reshape(4, 4))
    return camera(scene, AWAY)


if __name__ == "__main__":
    fresh()
    cards()
    cuboid("Body", (20.0, 4.0, 2.0), (10.0, 4.0, 0.0), material("body", node("RGB", 0)))
    save(FOLDER / "cards.blend")
    pictures = {"original": camera(bpy.context.scene, np.eye(4))}
    pictures["scenery"] = twin("scenery", scale=0.5, up="y")
    duplicates.FEWEST = 1
    pictures["vehicle"] = twin("vehicle", keep=("*",))
    np.savez(FOLDER / "pictures.npz", **pictures)
    (FOLDER / "cards.json").write_text(json.dumps(CARDS))
