"""Builds .blend files as people bring them, and renders with Cycles what they show. Run by test_export.py, in Blender.

``python messy_blends.py FOLDER build`` writes for each case FOLDER/<case>.blend and FOLDER/<case>.<view>.png (what
Cycles shows of what belongs to the case, without its clutter), and FOLDER/cases.json with the cameras in the world of
the file. ``python messy_blends.py FOLDER tidy`` renders the tidy twins that FOLDER/tidy.json names.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

SIZE = 160
FOV = math.radians(40)
FOLDER = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
CASES: dict[str, Callable[[], dict]] = {}


def case(build: Callable[[], dict]) -> Callable[[], dict]:
    CASES[build.__name__] = build
    return build


def link(obj, collection=None):
    (collection or bpy.context.scene.collection).objects.link(obj)
    return obj


def empty(name, at=(0, 0, 0), parent=None, rot=(0, 0, 0), scale=(1, 1, 1), collection=None):
    obj = link(bpy.data.objects.new(name, None), collection)
    obj.location, obj.rotation_euler, obj.scale, obj.parent = at, rot, scale, parent
    return obj


def box(name, size, at=(0, 0, 0), parent=None, rot=(0, 0, 0), scale=(1, 1, 1), collection=None, shift=(0, 0, 0)):
    """A wedge-shaped box (no symmetry that would hide a mirrored or turned axis); `shift` moves it off its origin."""
    sx, sy, sz = (s / 2 for s in size)
    points = [(-sx, -sy, -sz), (sx, -sy, -sz), (sx, sy, -sz), (-sx, sy, -sz)]
    points += [(-sx, -sy, sz), (0.7 * sx, -sy, 0.8 * sz), (0.5 * sx, 0.6 * sy, sz), (-sx, sy, 0.9 * sz)]
    mesh = bpy.data.meshes.new(name)
    faces = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    mesh.from_pydata([tuple(np.add(p, shift)) for p in points], [], faces)
    obj = link(bpy.data.objects.new(name, mesh), collection)
    obj.location, obj.rotation_euler, obj.scale, obj.parent = at, rot, scale, parent
    return obj


def collection(name, parent=None):
    made = bpy.data.collections.new(name)
    (parent or bpy.context.scene.collection).children.link(made)
    return made


def layer(name, root=None):
    root = root or bpy.context.view_layer.layer_collection
    for child in root.children:
        if child.name == name:
            return child
        if found := layer(name, child):
            return found
    return None


def tank(parent=None, coll=None, *, turret_deg=0.0, gun_deg=0.0, turn=(0, 0, 0)):
    """Hull, turret and gun under empties; the angles are what a plan would ask for."""
    box("Hull", (6, 3, 1), (0, 0, 1), parent, collection=coll)
    box("Nose", (1, 2, 0.6), (3.2, 0.2, 1), parent, collection=coll)
    turret = empty("Turret", (0.5, 0.1, 1.5), parent, (0, 0, math.radians(turret_deg)), collection=coll)
    box("Dome", (2.4, 2, 0.8), (0, 0, 0.4), turret, collection=coll)
    gun = empty("Gun", (1, 0, 0.4), turret, (0, -math.radians(gun_deg), 0), collection=coll)
    box("Tube", (3, 0.25, 0.25), (1.5, 0, 0), gun, collection=coll)
    return turret, gun


@case
def modifiers():
    """Levels and switches that differ between viewport and render; mirrors; arrays; odd scales."""
    hull = box("Hull", (6, 3, 1), (0, 0, 1))
    smooth = hull.modifiers.new("s", "SUBSURF")
    smooth.levels, smooth.render_levels = 0, 3
    shown = box("Crate", (1, 1, 1), (-1, 0, 2.2))
    only_render = shown.modifiers.new("a", "ARRAY")
    only_render.count, only_render.show_viewport, only_render.show_render = 3, False, True
    plain = box("Rail", (1, 0.3, 0.3), (0, 2, 2))
    only_viewport = plain.modifiers.new("a", "ARRAY")
    only_viewport.count, only_viewport.show_viewport, only_viewport.show_render = 8, True, False
    wheel = box("Wheel", (0.8, 0.3, 0.8), (2, 0, 0.4), shift=(0, 1.5, 0))
    wheel.modifiers.new("m", "MIRROR").use_axis = (False, True, False)
    box("Flipped", (1, 0.6, 0.7), (-2.5, -0.8, 1.9), rot=(0.3, 0.2, 0.5), scale=(-1.5, 0.4, 1.2))
    root = empty("Root", (0.5, 0.2, 0.3), rot=(0.1, -0.2, 0.4), scale=(1.2, 0.7, -1.1))
    box("Sheared", (1, 1, 1), (1.5, 1, -2.5), root, rot=(0.5, 0.6, 0.7), scale=(1, 2, 0.5))
    box("EyeHidden", (0.6, 0.6, 2), (-2.5, 1, 2.2)).hide_set(True)
    box("RenderHidden", (0.6, 0.6, 4), (2.5, 1, 2.2)).hide_render = True
    off = collection("Off")
    box("InHidden", (3, 3, 3), (0, 0, 4), collection=off)
    off.hide_render = True
    bounced = collection("Bounced")
    box("InIndirect", (3, 3, 3), (0, 0, 4), collection=bounced)
    layer("Bounced").indirect_only = True
    punched = collection("Punched")
    box("InHoldout", (0.5, 0.5, 5), (0, 0, 9), collection=punched)
    layer("Punched").holdout = True
    out = collection("Out")
    box("InExcluded", (3, 3, 3), (0, 0, 4), collection=out)
    layer("Out").exclude = True
    return {"hidden": ["RenderHidden", "InHidden", "InExcluded"]}


@case
def clutter():
    """What a vehicle's file is full of besides the vehicle; two floors have names that say nothing."""
    tank()
    box("Cabin_Floor", (2, 2, 0.1), (-1.5, 0, 1.6))
    box("Plane.004", (0.05, 2.5, 0.8), (-3.4, 0, 1))
    litter = [
        box("Floor", (40, 40, 0.1), (0, 0, -0.05)),
        box("Object_17", (90, 70, 0.01), (3, 2, -0.2)),
        box("shadowCatcher.002", (9, 9, 0.02), (0, 0, 0.3)),
        box("UCX_Hull_01", (6.4, 3.4, 3), (0, 0, 1.5)),
        box("Backdrop", (0.2, 30, 12), (-15, 0, 6)),
        box("ground", (2, 1, 0.02), (0, 0, 0.49)),
        box("ref_side", (9, 0.01, 5), (0, 6, 2)),
    ]
    caught = box("Catcher", (8, 8, 0.1), (0, 0, 0.4))
    caught.is_shadow_catcher = True
    ghost = box("Ghost", (4, 4, 4), (0, 0, 3))
    ghost.visible_camera = False
    link(bpy.data.objects.new("Key", bpy.data.lights.new("Key", "AREA")))
    link(bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera")))
    return {"hide": [o.name for o in [*litter, caught, ghost]]}


def keyframed(turret_deg, gun_deg):
    """Turret and gun under a turned, unevenly scaled root; key frames and a driver pull at them."""
    root = empty("Wreck", (3, -2, 0.7), rot=(0, 0, math.radians(35)), scale=(1.1, 1.1, 1.1))
    turret, gun = tank(root, turret_deg=turret_deg, gun_deg=gun_deg)
    for obj, axis in ((turret, 2), (gun, 1)):
        at_frame = obj.rotation_euler[axis]
        obj.rotation_euler[axis] = at_frame - 1
        obj.keyframe_insert("rotation_euler", frame=1)
        obj.rotation_euler[axis] = at_frame
        obj.keyframe_insert("rotation_euler", frame=30)
    bpy.context.scene.frame_set(30)
    return {"yaw_deg": 35.0}


@case
def instances():
    """Nested collections, instances on vertices and faces, hidden emitters, cutters, shape keys, simplified levels."""
    box("Hull", (6, 3, 1), (0, 0, 1))
    inner, outer = (bpy.data.collections.new(n) for n in ("inner", "outer"))
    box("Bolt", (0.4, 0.3, 0.6), (0.3, 0, 0), collection=inner, rot=(0, 0, 0.5))
    inner.instance_offset = (0.1, 0.2, 0)
    for i in range(2):
        spot = empty(f"spot{i}", (1 - 2 * i, 0, 0), scale=(1, 1, 1 + i), rot=(0, 0.3, 0), collection=outer)
        spot.instance_type, spot.instance_collection = "COLLECTION", inner
    carrier = empty("carrier", (0, 0.5, 1.8), rot=(0, 0, 0.7), scale=(1.2, 0.8, 1))
    carrier.instance_type, carrier.instance_collection = "COLLECTION", outer
    for kind, at in (("VERTS", (-2, -0.8, 2)), ("FACES", (2, -0.8, 2))):
        frame = box(f"Frame {kind}", (1, 0.8, 0.8), at)
        frame.instance_type, frame.show_instancer_for_render = kind, False
        frame.use_instance_faces_scale = True
        box(f"Rivet {kind}", (0.2, 0.15, 0.3), (9, 9, 9), frame)
    box("MonitorHidden", (0.5, 0.5, 1.5), (0, -1, 2)).hide_viewport = True
    drum = box("Drum", (1, 1, 1), (-2, 1, 2))
    cutter = box("Cutter", (0.5, 0.5, 3), (-2, 1, 2))
    cutter.hide_render = True
    cut = drum.modifiers.new("b", "BOOLEAN")
    cut.object, cut.operation = cutter, "DIFFERENCE"
    bent = box("Bent", (0.5, 0.5, 1), (2.5, 1, 2))
    bent.shape_key_add(name="Basis")
    key = bent.shape_key_add(name="up")
    key.data[6].co.z += 1.5
    key.value = 0.8
    fine = box("Fine", (0.7, 0.7, 0.7), (0.5, -1, 2))
    fine.modifiers.new("s", "SUBSURF").render_levels = 4
    scene = bpy.context.scene
    scene.render.use_simplify, scene.render.simplify_subdivision_render = True, 1
    return {}


@case
def keyframes():
    return keyframed(0.0, 0.0)


@case
def keyframes_turned():
    return keyframed(70.0, 12.0)


@case
def collections():
    """Turret and gun by collection, with everything at the world's origin but a pivot empty."""
    vehicle = collection("Turreted vehicle")
    box("Body", (6, 3, 1), shift=(0, 0, 1), collection=vehicle)
    turret = collection("TURRET.001", vehicle)
    box("a", (2.4, 2, 0.8), shift=(0.5, 0, 1.9), collection=turret)
    box("b", (0.8, 0.8, 0.4), shift=(-0.2, 0.4, 2.5), collection=turret)
    empty("pivot", (0.4, 0.05, 1.5), collection=turret)
    gun = collection("main gun", turret)
    box("c", (3, 0.25, 0.25), shift=(3, 0, 1.9), collection=gun)
    return {}


@case
def no_origins():
    """Root objects named turret and gun whose origins were left at zero, and names that clash into .001."""
    for number in range(2):
        box("Wheel", (1, 0.3, 1), (1.5, 1.4 - 2.8 * number, 0.5))
    box("Turret", (0.2, 0.2, 3), (-20, 0, 0)).hide_render = True
    box("Hull", (6, 3, 1), shift=(0, 0, 1))
    box("Turret", (2.4, 2, 0.8), shift=(1.7, 0, 1.9))
    box("Barrel", (3, 0.25, 0.25), (4.4, 0, 1.9))
    return {}


@case
def surfaces():
    """Curves, texts, metaballs and surfaces are rendered, so they count; loose vertices are not."""
    hull = box("Hull", (6, 3, 1), (0, 0, 1))
    hull.data.vertices.add(1)
    hull.data.vertices[-1].co = (0, 0, 50)
    bpy.ops.curve.primitive_bezier_circle_add(radius=1, location=(0, 0, 2.5), rotation=(0.5, 0, 0))
    bpy.context.object.data.bevel_depth = 0.2
    bpy.ops.object.text_add(location=(-3, -1.6, 1.2), rotation=(math.pi / 2, 0, 0))
    bpy.context.object.data.extrude = 0.1
    bpy.context.object.data.body = "07"
    bpy.ops.object.metaball_add(type="BALL", radius=1, location=(2, 0, 2))
    bpy.ops.surface.primitive_nurbs_surface_sphere_add(radius=0.6, location=(-2, 0.5, 2.1))
    link(bpy.data.objects.new("Path", bpy.data.curves.new("Path", "CURVE")))
    return {}


@case
def centimetres():
    bpy.context.scene.unit_settings.scale_length = 0.01
    tank(empty("Scaled", scale=(100, 100, 100)))
    return {"file_from_metres": Matrix.Scale(100, 4)}


@case
def y_up():
    """As some exporters leave it: y is up, the nose points along x."""
    tank(empty("Upside", rot=(-math.pi / 2, 0, 0)))
    return {"file_from_metres": Matrix.Rotation(-math.pi / 2, 4, "X"), "options": {"up": "y"}}


@case
def faces_minus_y():
    tank(empty("Turned", rot=(0, 0, -math.pi / 2)))
    return {"file_from_metres": Matrix.Rotation(-math.pi / 2, 4, "Z"), "options": {"forward": "-y"}}


@case
def armature():
    """A turret that hangs on a bone."""
    box("Hull", (6, 3, 1), (0, 0, 1))
    rig = link(bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig")))
    rig.location = (0.2, 0, 0)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bone = rig.data.edit_bones.new("turret")
    bone.head, bone.tail = (0.3, 0, 1.5), (0.3, 0, 2.5)
    bpy.ops.object.mode_set(mode="OBJECT")
    dome = box("Dome", (2.4, 2, 0.8), (0, 0, 0), rig)
    dome.parent_type, dome.parent_bone = "BONE", "turret"
    return {}


@case
def library_vehicle():
    """Not a case of its own to look at: the file that `linked` links from."""
    coll = collection("Tank asset")
    tank(coll=coll)
    return {}


@case
def linked():
    """The vehicle is an instance of a linked collection, turned, mirrored and scaled."""
    with bpy.data.libraries.load(str(FOLDER / "library_vehicle.blend"), link=True, relative=True) as (_, target):
        target.collections = ["Tank asset"]
    carrier = empty("Instance", (4, 5, 1), rot=(0, 0, math.radians(20)), scale=(1.5, -1.5, 1.5))
    carrier.instance_type, carrier.instance_collection = "COLLECTION", target.collections[0]
    return {"yaw_deg": 20.0}


def scatter(name, obj=None):
    """A node group that keeps the mesh and puts an instance (of `obj`, or a cube of its own) on each vertex."""
    group = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    nodes = {k: group.nodes.new(k) for k in ("NodeGroupInput", "NodeGroupOutput", "GeometryNodeJoinGeometry")}
    on_points = group.nodes.new("GeometryNodeInstanceOnPoints")
    if obj:
        source = group.nodes.new("GeometryNodeObjectInfo")
        source.inputs["Object"].default_value, source.inputs["As Instance"].default_value = obj, True
        made = source.outputs["Geometry"]
    else:
        made = group.nodes.new("GeometryNodeMeshCube").outputs["Mesh"]
    join = nodes["GeometryNodeJoinGeometry"]
    for a, b in (
        (made, on_points.inputs["Instance"]),
        (nodes["NodeGroupInput"].outputs[0], on_points.inputs["Points"]),
        (nodes["NodeGroupInput"].outputs[0], join.inputs[0]),
        (on_points.outputs[0], join.inputs[0]),
        (join.outputs[0], nodes["NodeGroupOutput"].inputs[0]),
    ):
        group.links.new(a, b)
    return group


def sheet(name, size, cells, at=(0, 0, 0), coll=None, shift=(0, 0, 0)):
    mesh = bpy.data.meshes.new(name)
    side = np.linspace(-size / 2, size / 2, cells + 1)
    points = [(x + shift[0], y + shift[1], 0.6 * math.sin(x / 5) + shift[2]) for y in side for x in side]
    n = cells + 1
    mesh.from_pydata(
        points,
        [],
        [(j * n + i, j * n + i + 1, (j + 1) * n + i + 1, (j + 1) * n + i) for j in range(cells) for i in range(cells)],
    )
    obj = link(bpy.data.objects.new(name, mesh), coll)
    obj.location = at
    return obj


@case
def scattered():
    """Trees and rocks by particles, geometry nodes, vertices and collections; LODs, fog and sky around them."""
    ground = sheet("Cube.001", 60, 6, coll=collection("Terrain"))
    stock = collection("Assets on the landscape")
    oak = box("Oak", (1, 1, 6), collection=stock, shift=(0, 0, 3))
    pebble = box("Pebble", (1.5, 1, 1), collection=stock)
    layer("Assets on the landscape").exclude = True
    ground.modifiers.new("p", "PARTICLE_SYSTEM")
    particles = ground.particle_systems[0].settings
    particles.type, particles.count, particles.use_advanced_hair = "HAIR", 12, True
    particles.render_type, particles.instance_object, particles.particle_size = "OBJECT", oak, 0.5
    carrier = sheet("Ground_spread", 20, 2, (0, 0, 0.5), coll=bpy.data.collections["Terrain"])
    carrier.modifiers.new("g", "NODES").node_group = scatter("object", pebble)
    second = sheet("Ground_cubes", 8, 1, (20, 20, 0), coll=bpy.data.collections["Terrain"])
    second.modifiers.new("g", "NODES").node_group = scatter("anonymous")
    for i in range(3):
        spot = empty(f"Terrain_rock_spot.{i:03}", (-20 + 9 * i, -15, 0), scale=(1 + i, 2, -1.5), rot=(0, 0, i))
        spot.instance_type, spot.instance_collection = "COLLECTION", stock
    for lod in (1, 2):
        sheet(f"Terrain_LOD{lod}", 60, 2).hide_render = True
    fog = box("Volume", (80, 80, 40))
    fog.data.materials.append(volume_material())
    sky = box("Skydome", (400, 400, 400))
    return {"hide": [fog.name, sky.name], "kind": "scenery", "distance": 75.0}


def volume_material():
    material = bpy.data.materials.new("fog")
    tree = material.node_tree
    output = tree.get_output_node("CYCLES")
    for old in list(output.inputs["Surface"].links):
        tree.links.remove(old)
    tree.links.new(tree.nodes.new("ShaderNodeVolumePrincipled").outputs[0], output.inputs["Volume"])
    return material


@case
def unnamed():
    """A scenery that does not say what its ground is."""
    sheet("Mesh", 60, 6)
    box("Thing", (5, 5, 5), (5, 5, 2))
    return {"kind": "scenery", "distance": 75.0}


MAP = (500_000.0, 5_400_000.0, 200.0)


@case
def map_in_mesh():
    """Map coordinates in the vertices."""
    sheet("Terrain", 64, 4, shift=MAP)
    box("Hut", (8, 6, 4), shift=np.add(MAP, (3, 2, 1)))
    return {"kind": "scenery", "truth": False, "centre": MAP, "distance": 75.0}


@case
def map_in_object():
    """Map coordinates in the object; what hangs on it has small ones, that float32 matrices would round to 0.5 m."""
    ground = sheet("Terrain", 64, 4, at=MAP)
    box("Hut", (8, 6, 4), (3.14159, 2.71828, 1.41421), ground, rot=(0, 0, 0.3))
    return {"kind": "scenery", "truth": False, "centre": MAP, "distance": 75.0}


@case
def textured():
    """Pictures that are there, packed, missing, missing in a library, and missing where nobody sees it."""
    picture = bpy.data.images.new("there", 4, 4)
    picture.filepath_raw, picture.file_format = str(FOLDER / "there.png"), "PNG"
    picture.save()
    packed = bpy.data.images.new("packed", 4, 4)
    packed.pack()
    hull, turret, _ = (box(n, (4, 2, 1), (0, 0, i)) for i, n in enumerate(("Hull", "Turret", "Spare")))
    floor = box("Floor", (60, 60, 0.1), (0, 0, -0.6))
    for obj, images in (
        (hull, [picture, packed]),
        (turret, [image("//textures/gone.png")]),
        (floor, [image("//floor_gone.png")]),
    ):
        material = bpy.data.materials.new(obj.name)
        for each in images:
            node = material.node_tree.nodes.new("ShaderNodeTexImage")
            node.image = each
        obj.data.materials.append(material)
    group = bpy.data.node_groups.new("inner", "ShaderNodeTree")
    group.nodes.new("ShaderNodeTexImage").image = image("//nested_gone.exr")
    bpy.data.materials["Turret"].node_tree.nodes.new("ShaderNodeGroup").node_tree = group
    return {"hide": ["Floor"]}


def image(path):
    made = bpy.data.images.new(Path(path).name, 1, 1)
    made.source, made.filepath = "FILE", path
    return made


@case
def lost_library():
    """A wheel comes from a library that is not there any more."""
    tank()
    with bpy.data.libraries.load(str(FOLDER / "soon_gone.blend"), link=True, relative=True) as (_, target):
        target.objects = ["Wheel"]
    link(target.objects[0])
    return {}


@case
def malicious():
    """A text that registers itself and a driver, both of which would write a file."""
    turret, _ = tank()
    order = f"open({str(FOLDER / 'ran')!r}, 'w').write('x')"
    text = bpy.data.texts.new("startup.py")
    text.from_string(f"import bpy\n{order}\nbpy.app.driver_namespace['f'] = lambda: {order}\n")
    text.use_module = True
    driver = turret.driver_add("rotation_euler", 2).driver
    driver.type, driver.expression = "SCRIPTED", f"{order} or 1.5"
    return {}


@case
def no_numbers():
    """A vertex that is no number, as broken exporters write them."""
    box("Hull", (6, 3, 1)).data.vertices[3].co.y = math.nan
    return {"truth": False}


@case
def nothing():
    """A camera, a lamp and something hidden."""
    link(bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera")))
    box("Hull", (6, 3, 1)).hide_render = True
    return {"truth": False}


@case
def odd_ones():
    """Two scenes, two view layers, and what Cycles makes of meshes that nobody else sees."""
    bpy.data.scenes.new("Other")
    bpy.context.scene.view_layers.new("Second")
    hull = box("Hull", (6, 3, 1), (0, 0, 1))
    hull.modifiers.new("s", "SUBSURF").use_adaptive_subdivision = True
    rough = box("Rough", (1, 1, 1), (0, 0, 2))
    material = bpy.data.materials.new("rough")
    material.displacement_method = "DISPLACEMENT"
    tree = material.node_tree
    tree.links.new(
        tree.nodes.new("ShaderNodeDisplacement").outputs[0], tree.get_output_node("CYCLES").inputs["Displacement"]
    )
    rough.data.materials.append(material)
    furry = box("Furry", (1, 1, 1), (2, 0, 2))
    furry.modifiers.new("p", "PARTICLE_SYSTEM")
    furry.particle_systems[0].settings.type = "HAIR"
    strands = link(bpy.data.objects.new("Strands", bpy.data.hair_curves.new("Strands")))
    strands.data.add_curves([4, 4])
    return {"truth": False}


@case
def nodes():
    """Parts that geometry nodes make: copies of an object, and cubes that no object has made."""
    hull = box("Hull", (6, 3, 1), (0, 0, 1))
    knob = box("Knob", (0.3, 0.2, 0.5), (0, 0, 9), shift=(0.1, 0, 0.2))
    knob.hide_render = True
    hull.modifiers.new("g", "NODES").node_group = scatter("knobs", knob)
    turret = box("Turret", (2, 2, 0.6), (0, 0, 2.4))
    turret.modifiers.new("g", "NODES").node_group = scatter("cubes")
    return {"distance": 20.0}


def build(name: str) -> dict:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    about = {"kind": "vehicle", "options": {}, "hide": [], "truth": True, "distance": 16.0, "yaw_deg": 0.0}
    about |= CASES[name]()
    about["file_from_metres"] = np.array(about.get("file_from_metres", Matrix.Identity(4))).tolist()
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / f"{name}.blend"), compress=name == "clutter")
    return about


def cameras_of(about: dict) -> list[Matrix]:
    """Looking at the middle from the front left and above, and from the back right; in the world of the file."""
    return [camera_at(about, 40, 0.6), camera_at(about, 205, 0.25)]


def camera_at(about: dict, yaw_deg: float, rise: float) -> Matrix:
    yaw = math.radians(about["yaw_deg"] + yaw_deg)
    out = Vector((math.cos(yaw), math.sin(yaw), rise)).normalized() * about["distance"]
    centre = Vector(about.get("centre", (0, 0, 1.2)))
    metres = Matrix.Translation(centre + out) @ out.to_track_quat("Z", "Y").to_matrix().to_4x4()
    return Matrix(about["file_from_metres"]) @ metres


def render_masks(poses: list[Matrix], path: Path, *, unit: float = 1.0) -> None:
    """Write what Cycles shows to each of the cameras as path.0.png, path.1.png, ..."""
    scene = bpy.context.scene
    camera = scene.camera = link(bpy.data.objects.new("truth camera", bpy.data.cameras.new("truth camera")))
    camera.data.sensor_fit, camera.data.angle = "HORIZONTAL", FOV
    camera.data.clip_start, camera.data.clip_end = 0.01 * unit, 1e5 * unit
    render = scene.render
    render.engine, render.film_transparent = "CYCLES", True
    render.resolution_x = render.resolution_y = SIZE
    render.resolution_percentage = 100
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGBA"
    render.use_compositing = False
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = 1, False, 0
    # One ray through the middle of each pixel.
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    scene.cycles.transparent_max_bounces = 0
    for i, pose in enumerate(poses):
        # A camera has no scale.
        camera.matrix_world = Matrix.LocRotScale(pose.to_translation(), pose.to_quaternion(), None)
        render.filepath = f"{path}.{i}.png"
        bpy.ops.render.render(write_still=True)


def build_all() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    box("Wheel", (1, 0.3, 1))
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "soon_gone.blend"))
    cases = {name: build(name) for name in CASES}
    (FOLDER / "soon_gone.blend").unlink()
    for name, about in cases.items():
        poses = cameras_of(about)
        about["cameras"] = np.array(poses).tolist()
        if about["truth"]:
            bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{name}.blend"), load_ui=False, use_scripts=False)
            for hidden in about["hide"]:
                bpy.data.objects[hidden].hide_render = True
            render_masks(poses, FOLDER / name, unit=Matrix(about["file_from_metres"]).median_scale)
    for name, suffix in (("y_up", "glb"), ("y_up", "fbx"), ("library_vehicle", "obj")):
        export_as(name, FOLDER / f"imported.{suffix}")
    (FOLDER / "cases.json").write_text(json.dumps(cases), encoding="utf-8")


def render_tidy() -> None:
    """Render the tidy twins named in tidy.json from the cameras given there, as the renderer would load them."""
    for name, twin in json.loads((FOLDER / "tidy.json").read_text(encoding="utf-8")).items():
        if twin["kind"] == "vehicle":
            bpy.ops.wm.read_factory_settings(use_empty=True)
            with bpy.data.libraries.load(twin["path"], link=False) as (source, target):
                target.collections = source.collections[:1]
            bpy.context.scene.collection.children.link(target.collections[0])
            root = empty("root")
            for obj in target.collections[0].objects:
                obj.parent = root
                obj.matrix_parent_inverse = Matrix(np.array(obj["hulldown_rest"]).reshape(4, 4))
        else:
            bpy.ops.wm.open_mainfile(filepath=twin["path"], load_ui=False, use_scripts=False)
            for obj in bpy.context.scene.objects:
                obj.hide_render = obj.name.partition(".")[0] in twin["hide"]
        render_masks([Matrix(c) for c in twin["cameras"]], FOLDER / f"{name}.tidy")


def export_as(name: str, path: Path) -> None:
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{name}.blend"), load_ui=False, use_scripts=False)
    if path.suffix == ".glb":
        bpy.ops.export_scene.gltf(filepath=str(path), export_apply=True, export_animations=False)
    elif path.suffix == ".fbx":
        bpy.ops.export_scene.fbx(filepath=str(path), bake_anim=False)
    else:
        bpy.ops.wm.obj_export(filepath=str(path))


if __name__ == "__main__":
    {"build": build_all, "tidy": render_tidy}[sys.argv[2]]()
