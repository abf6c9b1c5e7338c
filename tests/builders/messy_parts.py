"""Building blocks of the messy cases: a tank, a sheet of ground, scattering nodes. In Blender."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from hulldown.tests.builders.blend_parts import empty, mesh, place
from hulldown.tests.builders.node_trees import node_group

FOLDER = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
CASES: dict[str, Callable[[], dict]] = {}


def case(build: Callable[[], dict]) -> Callable[[], dict]:
    """Register a case under the name of its function, which returns the case's differences from the defaults."""
    CASES[build.__name__] = build
    return build


def box(name, size, *where, shift=(0, 0, 0), **more):
    """A wedge-shaped box, whose asymmetry shows mirrored and turned axes; `shift` moves it off its origin."""
    sx, sy, sz = (s / 2 for s in size)
    points = [(-sx, -sy, -sz), (sx, -sy, -sz), (sx, sy, -sz), (-sx, sy, -sz)]
    points += [(-sx, -sy, sz), (0.7 * sx, -sy, 0.8 * sz), (0.5 * sx, 0.6 * sy, sz), (-sx, sy, 0.9 * sz)]
    faces = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return place(name, mesh(name, [tuple(np.add(p, shift)) for p in points], faces), *where, **more)


def layer(name, root=None):
    root = root or bpy.context.view_layer.layer_collection
    for child in root.children:
        if child.name == name:
            return child
        if found := layer(name, child):
            return found
    return None


def tank(parent=None, coll=None, *, turret_deg=0.0, gun_deg=0.0, turn=(0, 0, 0)):
    """Hull, turret, and gun under empties; the angles are those of a plan."""
    box("Hull", (6, 3, 1), (0, 0, 1), parent, collection=coll)
    box("Nose", (1, 2, 0.6), (3.2, 0.2, 1), parent, collection=coll)
    turret = empty("Turret", (0.5, 0.1, 1.5), parent, (0, 0, math.radians(turret_deg)), collection=coll)
    box("Dome", (2.4, 2, 0.8), (0, 0, 0.4), turret, collection=coll)
    gun = empty("Gun", (1, 0, 0.4), turret, (0, -math.radians(gun_deg), 0), collection=coll)
    box("Tube", (3, 0.25, 0.25), (1.5, 0, 0), gun, collection=coll)
    return turret, gun


def scatter(name, obj=None):
    """A node group that keeps the mesh and puts an instance (of `obj`, or of a new cube) on each vertex."""
    group, given, result = node_group("Geometry")
    group.name = name
    nodes, link = group.nodes, group.links.new
    if obj:
        source = nodes.new("GeometryNodeObjectInfo")
        source.inputs["Object"].default_value, source.inputs["As Instance"].default_value = obj, True
        made = source.outputs["Geometry"]
    else:
        made = nodes.new("GeometryNodeMeshCube").outputs["Mesh"]
    on_points, join = nodes.new("GeometryNodeInstanceOnPoints"), nodes.new("GeometryNodeJoinGeometry")
    link(made, on_points.inputs["Instance"])
    link(given[0], on_points.inputs["Points"])
    link(given[0], join.inputs[0])
    link(on_points.outputs[0], join.inputs[0])
    link(join.outputs[0], result[0])
    return group


def sheet(name, size, cells, at=(0, 0, 0), coll=None, shift=(0, 0, 0)):
    side = np.linspace(-size / 2, size / 2, cells + 1)
    points = [(x + shift[0], y + shift[1], 0.6 * math.sin(x / 5) + shift[2]) for y in side for x in side]
    n = cells + 1
    faces = [(j * n + i, j * n + i + 1, (j + 1) * n + i + 1, (j + 1) * n + i) for j in range(cells) for i in range(cells)]
    return place(name, mesh(name, points, faces), at, collection=coll)
