"""Vehicles as people build them: modifiers, instances, key frames, bones, links, other units and axes. In Blender."""

from __future__ import annotations

import math

import bpy
from mathutils import Matrix

from hulldown.tests.builders.blend_parts import collection, empty, from_library, instance, place
from hulldown.tests.builders.messy_parts import FOLDER, box, case, layer, scatter, tank


@case
def modifiers():
    """Levels and switches that differ between viewport and render; mirrors, arrays, odd scales."""
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
    return {}


@case
def instances():
    """Nested collections, instances on vertices and faces, hidden emitters, cutters, shape keys, simplified levels."""
    box("Hull", (6, 3, 1), (0, 0, 1))
    inner, outer = (bpy.data.collections.new(n) for n in ("inner", "outer"))
    box("Bolt", (0.4, 0.3, 0.6), (0.3, 0, 0), collection=inner, rot=(0, 0, 0.5))
    inner.instance_offset = (0.1, 0.2, 0)
    for i in range(2):
        instance(f"spot{i}", inner, (1 - 2 * i, 0, 0), scale=(1, 1, 1 + i), rot=(0, 0.3, 0), collection=outer)
    instance("carrier", outer, (0, 0.5, 1.8), rot=(0, 0, 0.7), scale=(1.2, 0.8, 1))
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
def collections():
    """Turret and gun are collections; everything has its origin at the world's, except for a pivot empty."""
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
    """Top-level objects named turret and gun with their origins at zero, and names that clash into .001."""
    for number in range(2):
        box("Wheel", (1, 0.3, 1), (1.5, 1.4 - 2.8 * number, 0.5))
    box("Turret", (0.2, 0.2, 3), (-20, 0, 0)).hide_render = True
    box("Hull", (6, 3, 1), shift=(0, 0, 1))
    box("Turret", (2.4, 2, 0.8), shift=(1.7, 0, 1.9))
    box("Barrel", (3, 0.25, 0.25), (4.4, 0, 1.9))
    return {}


@case
def surfaces():
    """Curves, texts, metaballs, and surfaces, which are rendered, and loose vertices, which aren't."""
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
    place("Path", bpy.data.curves.new("Path", "CURVE"))
    return {}


@case
def armature():
    """A turret parented to a bone."""
    box("Hull", (6, 3, 1), (0, 0, 1))
    rig = place("Rig", bpy.data.armatures.new("Rig"), (0.2, 0, 0))
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bone = rig.data.edit_bones.new("turret")
    bone.head, bone.tail = (0.3, 0, 1.5), (0.3, 0, 2.5)
    bpy.ops.object.mode_set(mode="OBJECT")
    dome = box("Dome", (2.4, 2, 0.8), (0, 0, 0), rig)
    dome.parent_type, dome.parent_bone = "BONE", "turret"
    return {}


@case
def nodes():
    """Geometry made by nodes: copies of an object, and cubes without an object."""
    hull = box("Hull", (6, 3, 1), (0, 0, 1))
    knob = box("Knob", (0.3, 0.2, 0.5), (0, 0, 9), shift=(0.1, 0, 0.2))
    knob.hide_render = True
    hull.modifiers.new("g", "NODES").node_group = scatter("knobs", knob)
    turret = box("Turret", (2, 2, 0.6), (0, 0, 2.4))
    turret.modifiers.new("g", "NODES").node_group = scatter("cubes")
    return {"distance": 20.0}


def keyframed(turret_deg, gun_deg):
    """Turret and gun under a turned, unevenly scaled root, with key frames and a driver."""
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
def keyframes():
    return keyframed(0.0, 0.0)


@case
def keyframes_turned():
    return keyframed(70.0, 12.0)


@case
def centimeters():
    bpy.context.scene.unit_settings.scale_length = 0.01
    tank(empty("Scaled", scale=(100, 100, 100)))
    return {"file_from_meters": Matrix.Scale(100, 4)}


@case
def y_up():
    """As some exporters write it: y is up, the nose points along x."""
    tank(empty("Upside", rot=(-math.pi / 2, 0, 0)))
    return {"file_from_meters": Matrix.Rotation(-math.pi / 2, 4, "X"), "options": {"up": "y"}}


@case
def faces_minus_y():
    tank(empty("Turned", rot=(0, 0, -math.pi / 2)))
    return {"file_from_meters": Matrix.Rotation(-math.pi / 2, 4, "Z"), "options": {"forward": "-y"}}


@case
def library_vehicle():
    """The library file of `linked`, and a plain tank."""
    coll = collection("Tank asset")
    tank(coll=coll)
    return {}


@case
def linked():
    """The vehicle is an instance of a linked collection, turned, mirrored, and scaled."""
    tank_asset = from_library(FOLDER / "library_vehicle.blend", "collections", "Tank asset", relative=True)
    instance("Instance", tank_asset, (4, 5, 1), rot=(0, 0, math.radians(20)), scale=(1.5, -1.5, 1.5))
    return {"yaw_deg": 20.0}
