"""Sceneries as people build them: scattered objects, meaningless names, map coordinates. In Blender."""

from __future__ import annotations

import bpy
import numpy as np

from hulldown.blender.add_nodes import add_node
from hulldown.tests.builders.blend_parts import collection, empty, instance, place
from hulldown.tests.builders.messy_parts import box, case, layer, scatter, sheet
from hulldown.tests.builders.node_trees import material_of

MAP = (500_000.0, 5_400_000.0, 200.0)


@case
def scattered():
    """Trees and rocks by particles, geometry nodes, vertices, and collections; LODs, fog, and a sky around them."""
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
        where, scale = (-20 + 9 * i, -15, 0), (1 + i, 2, -1.5)
        instance(f"Terrain_rock_spot.{i:03}", stock, where, scale=scale, rot=(0, 0, i))
    for lod in (1, 2):
        sheet(f"Terrain_LOD{lod}", 60, 2).hide_render = True
    fog = box("Volume", (80, 80, 40))
    fog.data.materials.append(material_of("fog", lambda tree: add_node(tree, "VolumePrincipled").outputs[0], socket="Volume"))
    sky = box("Skydome", (400, 400, 400))
    return {"hide": [fog.name, sky.name], "kind": "scenery", "distance": 75.0}


@case
def hairy():
    """Reeds of hair: copies placed by nodes, tapered, without a radius; and ground covered with hair."""
    ground = sheet("Terrain", 30, 3)
    reeds = hair("Reeds", thick=0.8)
    reeds.location = (60, 60, -40)
    for i in range(6):
        where, scale = (-12 + 5 * i, 2 * i - 6, -0.5), (1, 1, 0.7 + 0.1 * i)
        place(f"Reeds.{i:03}", reeds.data, where, rot=(0.1, 0, i), scale=scale)
    ground.modifiers.new("g", "NODES").node_group = scatter("reeds", reeds)
    hair("Terrain_Fluff", thick=None).location = (0, 0, 4)
    return {"kind": "scenery", "distance": 75.0}


@case
def furry():
    """Particle strands, with and without children, on an object that isn't rendered."""
    sheet("Terrain", 12, 1)
    carrier = sheet("Terrain_Furry", 20, 1, (2, 3, 3))
    carrier.scale, carrier.rotation_euler, carrier.show_instancer_for_render = (0.5, 1, 1.2), (0, 0, 0.5), False
    for name, children in (("alone", "NONE"), ("with children", "SIMPLE")):
        carrier.modifiers.new(name, "PARTICLE_SYSTEM")
        strands = carrier.particle_systems[-1].settings
        strands.type, strands.count, strands.hair_length = "HAIR", 8, 9
        strands.child_type, strands.rendered_child_count, strands.child_radius = children, 3, 4
        strands.root_radius, strands.tip_radius, strands.radius_scale, strands.shape = 2, 0.6, 0.7, 0.4
    return {"kind": "scenery", "distance": 75.0}


def hair(name, *, thick):
    """Four leaning, tapered strands of hair."""
    curves = bpy.data.hair_curves.new(name)
    curves.add_curves([3] * 4)
    foot = np.array([[-2.5, -1, 0], [-1, 2, 0], [1.5, -2, 0], [3, 1, 0]])
    lean = np.array([[-0.3, 0, 1], [0, 0.4, 1], [0.2, 0.1, 1], [0.4, -0.3, 1]])
    points = foot[:, None] + lean[:, None] * np.array([0, 5, 9])[:, None]
    curves.points.foreach_set("position", points.astype(np.float32).ravel())
    if thick:
        radius = np.tile(thick * np.array([1.0, 0.8, 0.3]), 4).astype(np.float32)
        curves.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", radius)
    return place(name, curves)


@case
def unnamed():
    """A scenery whose ground has a meaningless name."""
    sheet("Mesh", 60, 6)
    box("Thing", (5, 5, 5), (5, 5, 2))
    return {"kind": "scenery", "distance": 75.0}


@case
def map_in_mesh():
    """Map coordinates in the vertices."""
    sheet("Terrain", 64, 4, shift=MAP)
    box("Hut", (8, 6, 4), shift=np.add(MAP, (3, 2, 1)))
    return {"kind": "scenery", "truth": False, "center": MAP, "distance": 75.0}


@case
def map_in_object():
    """Map coordinates in the object; its children have small ones, which float32 matrices would round to 0.5 m."""
    ground = sheet("Terrain", 64, 4, at=MAP)
    box("Hut", (8, 6, 4), (3.14159, 2.71828, 1.41421), ground, rot=(0, 0, 0.3))
    box("Barn", (8, 6, 4), (1_036_604.5, 5_323_106.0, 201.0), empty("Survey", (0, 0, 0), rot=(0, 0, 0.1)))
    return {"kind": "scenery", "truth": False, "center": MAP, "distance": 75.0}
