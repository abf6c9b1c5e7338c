"""Hair in Blender: hair curves, and particle strands; and point clouds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float

from hulldown.blender.buffers import read_property
from hulldown.geometry.meshes import Mesh
from hulldown.reading.scenery.hair import hair_mesh

OCTAHEDRON_FACES = [(x, y, z) for x in (0, 3) for y in (1, 4) for z in (2, 5)]
# Blender's numbers of curve types. Cycles draws Bezier curves and NURBS as splines through their points too.
CATMULL_ROM, POLY = 0, 1
DEFAULT_RADIUS_M = 0.005  # Cycles in Blender 5.0 draws curves without radii so


def hair_curves_mesh(curves: Any, name: str) -> Mesh | None:
    """Return a mesh that hides as much as hair curves, in their frame; None if there are none."""
    points = read_property(curves.points, "position", np.float32, 3).reshape(-1, 3)
    first = read_property(curves.curves, "first_point_index", np.int32)
    radii, kind = np.full(len(points), DEFAULT_RADIUS_M, np.float32), np.full(len(first), CATMULL_ROM)
    if "radius" in curves.attributes:
        radii = read_property(curves.points, "radius", np.float32)
    if "curve_type" in curves.attributes:
        kind = read_property(curves.attributes["curve_type"].data, "value", np.int32)
    return hair_mesh(points.astype(float), radii.astype(float), first, kind == POLY, name)


def point_cloud_mesh(cloud: Any, name: str) -> Mesh | None:
    """Return octahedra that hide as much as a point cloud's spheres by Cauchy's theorem; None if there are none."""
    points = read_property(cloud.points, "co", np.float32, 3).reshape(-1, 1, 3).astype(float)
    radii = read_property(cloud.points, "radius", np.float32).astype(float)
    if not len(points):
        return None
    corners = np.concatenate([np.eye(3), -np.eye(3)]) * np.sqrt(np.pi / np.sqrt(3.0))
    vertices = (points + radii[:, None, None] * corners).reshape(-1, 3)
    faces = np.array([(a, b, c) if a // 3 + b // 3 + c // 3 in (0, 2) else (a, c, b) for a, b, c in OCTAHEDRON_FACES])
    return Mesh(vertices, (faces + 6 * np.arange(len(points))[:, None, None]).reshape(-1, 3), name)


def strand_systems(drawn: Any) -> list[Any]:
    """Return the particle systems of an evaluated object that draw strands, and not copies of objects."""
    systems = [m.particle_system for m in drawn.modifiers if m.type == "PARTICLE_SYSTEM" and m.show_render]
    drawing = [s for s in systems if s.settings.type == "HAIR" and s.settings.render_type == "PATH"]
    return [s for s in drawing if len(s.particles) or len(s.child_particles)]  # Blender crashes on curves of none


def strands_mesh_and_materials(drawn: Any, system: Any) -> tuple[Mesh | None, list[Any]]:
    """Return the mesh of a particle system's strands, in the object's frame, and its material."""
    settings = system.settings
    parents, children = len(system.particles), len(system.child_particles)
    # As Cycles takes them: where there are children, their parents only guide them.
    strands = range(parents if children else 0, parents + children)
    steps = 2**settings.render_step + 1
    where = [system.co_hair(drawn, particle_no=i, step=k) for i in strands for k in range(steps)]
    points = np.array(where, dtype=np.float64).reshape(len(strands), steps, 3)
    length = np.cumsum(np.linalg.norm(np.diff(points, axis=1, prepend=points[:, :1]), axis=2), axis=1)
    along = length / np.maximum(length[:, -1:], np.finfo(float).tiny)
    # Blender gives the strands where the object is; one that is squashed flat has no inverse.
    world_from_drawn = np.array(drawn.matrix_world, dtype=np.float64)
    if not (np.isfinite(points).all() and np.isfinite(world_from_drawn).all()):
        raise ValueError(f"the strands of {system.name!r} have coordinates that aren't numbers")
    inside = (points.reshape(-1, 3) - world_from_drawn[:3, 3]) @ np.linalg.pinv(world_from_drawn[:3, :3]).T
    radii, first = _strand_radii(settings, along).ravel(), steps * np.arange(len(strands))
    mesh = hair_mesh(inside, radii, first, np.zeros(len(strands), dtype=bool), system.name)
    return mesh, [slot.material for slot in drawn.material_slots[settings.material - 1 : settings.material]]


def make_hair_datablock(mesh: Mesh, materials: Sequence[Any]) -> Any:
    """Make a datablock of a hair's mesh, so that pictures show what hides vehicles; smooth, so that it looks round."""
    block, faces = bpy.data.meshes.new(mesh.name), mesh.faces.astype(np.int32)
    block.vertices.add(len(mesh.vertices))
    block.loops.add(faces.size)
    block.polygons.add(len(faces))
    block.vertices.foreach_set("co", mesh.vertices.astype(np.float32).ravel())
    block.loops.foreach_set("vertex_index", faces.ravel())
    block.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    block.shade_smooth()
    block.update(calc_edges=True)
    for material in materials:
        block.materials.append(material and material.original)  # the evaluated one ends before the block does
    return block


def _strand_radii(settings: Any, along: Float[np.ndarray, "s k"]) -> Float[np.ndarray, "s k"]:
    """Return radii at shares of each strand's length; root, tip, and shape are as in Blender's manual."""
    shape = settings.shape
    left = (1 - along) ** (1 + shape if shape < 0 else 1 / max(1 - shape, 1e-6))
    radii = settings.radius_scale / 2 * (settings.tip_radius + left * (settings.root_radius - settings.tip_radius))
    if settings.use_close_tip:
        radii[:, -1] = 0.0
    return np.asarray(radii)
