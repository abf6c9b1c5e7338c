"""Buildings as objects in Blender: extruded outlines with level roofs."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from hulldown.geometry.meshes import Mesh
from hulldown.placement.terrain import Terrain
from hulldown.reading.scenery.buildings import Building
from hulldown.reading.scenery.geotiff import Elevations

DEEP = 1.0  # meters of wall below the lowest ground
COLOR = (0.36, 0.31, 0.25, 1.0)


def add_buildings(buildings: Sequence[Building], terrain: Elevations) -> int:
    """Make an object of each building completely on the terrain; return their number.

    A height counts from the mean of the ground along the outline.
    """
    ground = Terrain(Mesh(terrain.vertices, terrain.faces))
    material = bpy.data.materials.new("building")
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value, shader.inputs["Roughness"].default_value = COLOR, 0.9
    standing = 0
    for rings, height in buildings:
        outlines = [ring - terrain.anchor[:2] for ring in rings]
        hits = ground.top_hits(np.concatenate(outlines or [np.zeros((1, 2))]))
        if not outlines or not hits.hit.all():
            continue
        standing += 1
        low, high = hits.z.min() - DEEP, max(hits.z.mean() + height, hits.z.max() + 1.0)
        curve = bpy.data.curves.new(f"building {standing}", "CURVE")
        curve.dimensions, curve.fill_mode, curve.extrude = "2D", "BOTH", float(high - low) / 2
        curve.materials.append(material)
        center = outlines[0].mean(axis=0)
        for outline in outlines:
            spline = curve.splines.new("POLY")
            spline.points.add(len(outline) - 1)
            spline.points.foreach_set("co", np.pad(outline - center, ((0, 0), (0, 2))).ravel())
            spline.use_cyclic_u, spline.use_smooth = True, False
        obj = bpy.data.objects.new(curve.name, curve)
        obj.location = terrain.anchor + np.append(center, (low + high) / 2)
        bpy.context.scene.collection.objects.link(obj)
    return standing
