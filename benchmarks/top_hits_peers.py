"""Peers that find the ground under points, each behind one call."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from hulldown.geometry.meshes import Mesh
from hulldown.placement.terrain import Terrain

Query = Callable[[np.ndarray], object]  # of (n, 2) points in the mesh's frame
DOWN = np.array([[0, 0, -1]], dtype=np.float32)


def hills(faces: int, *, seed: int = 0) -> Mesh:
    """Return rolling, rough terrain of about so many triangles with sides of 1 m, and vertices off any lattice."""
    rng = np.random.default_rng(seed)
    n = max(1, round((faces / 2) ** 0.5))
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij")
    z = 8 * np.sin(x / 41) * np.cos(y / 53) + 2 * np.sin(x / 7 + y / 11) + 0.1 * rng.standard_normal(x.shape)
    vertices = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    inner = (x > 0) & (x < n) & (y > 0) & (y < n)
    vertices[inner.ravel(), :2] += rng.uniform(-0.3, 0.3, (int(inner.sum()), 2))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    return Mesh(vertices, np.concatenate([np.stack([i, i + n + 1, i + 1], 1), np.stack([i + 1, i + n + 1, i + n + 2], 1)]))


def points(mesh: Mesh, n: int, *, seed: int = 1) -> np.ndarray:
    """Random points over the whole mesh."""
    low, high = mesh.bounds[:, :2]
    return np.random.default_rng(seed).uniform(low, high, (n, 2))


def raw_embreex(mesh: Mesh) -> Callable[[np.ndarray], np.ndarray]:
    """Embreex as it comes: rays in the order given, float32 in the mesh's own coordinates; the faces."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, mesh.vertices.astype(np.float32), mesh.faces)
    above = mesh.bounds[1, 2] + 1.0
    scene.run(np.zeros((1, 3), np.float32), DOWN)  # builds

    def query(xy: np.ndarray) -> np.ndarray:
        origins = np.empty((len(xy), 3), dtype=np.float32)
        origins[:, :2], origins[:, 2] = xy, above
        return scene.run(origins, DOWN)

    return query


def sorted_embreex(mesh: Mesh) -> Callable[[np.ndarray], np.ndarray]:
    """Return embreex with a user's remedies for speed and rounding: points sorted by cells, and a centered mesh."""
    center = mesh.bounds.mean(axis=0)
    raw, low, extent = raw_embreex(Mesh(mesh.vertices - center, mesh.faces)), mesh.bounds[0, :2], np.ptp(mesh.bounds, 0)

    def query(xy: np.ndarray) -> np.ndarray:
        column, row = ((xy - low) * (255.0 / extent[:2])).astype(np.uint16).T
        order = np.argsort(256 * column + np.where(column % 2, 255 - row, row), kind="stable")  # there and back
        faces = np.empty(len(xy), dtype=np.int32)
        faces[order] = raw(xy[order] - center[:2])
        return faces

    return query


def by_two_threads(query: Callable[[np.ndarray], object]) -> Query:
    """Return the query on two threads, each with half of the points: the speedup of threads that share nothing."""
    pool = ThreadPoolExecutor(2)
    return lambda xy: list(pool.map(query, np.array_split(xy, 2)))


def ours(mesh: Mesh) -> dict[str, Query]:
    """Return our own, on one thread and on two."""
    terrain = Terrain(mesh)
    return {"hulldown": terrain.top_hits, "hulldown, 2 threads": by_two_threads(terrain.top_hits)}


def trimesh_peer(mesh: Mesh) -> dict[str, Query]:
    """Trimesh over embreex: the face alone, and the location."""
    import trimesh

    rays = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).ray
    above = mesh.bounds[1, 2] + 1.0

    def down(xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.column_stack([xy, np.full(len(xy), above)]), np.tile([0.0, 0.0, -1.0], (len(xy), 1))

    return {
        "trimesh intersects_first": lambda xy: rays.intersects_first(*down(xy)),
        "trimesh intersects_location": lambda xy: rays.intersects_location(*down(xy), multiple_hits=False),
    }


def open3d_peer(mesh: Mesh) -> dict[str, Query]:
    """Open3D's RaycastingScene on one thread and on two."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.core.Tensor(mesh.vertices.astype(np.float32)), open3d.core.Tensor(mesh.faces.astype(np.uint32)))
    above = mesh.bounds[1, 2] + 1.0

    def cast(xy: np.ndarray, threads: int) -> object:
        rays = np.zeros((len(xy), 6), dtype=np.float32)
        rays[:, :2], rays[:, 2], rays[:, 5] = xy, above, -1
        return scene.cast_rays(open3d.core.Tensor(rays), nthreads=threads)

    cast(mesh.bounds[:1, :2], 1)  # builds
    return {"Open3D": lambda xy: cast(xy, 1), "Open3D, 2 threads": lambda xy: cast(xy, 2)}


def blender_peer(mesh: Mesh) -> dict[str, Query]:
    """Blender as the paper uses it: one Python call a ray."""
    import bpy
    from mathutils import Vector
    from mathutils.bvhtree import BVHTree

    bpy.ops.wm.read_factory_settings(use_empty=True)
    data = bpy.data.meshes.new("ground")
    data.vertices.add(len(mesh.vertices))
    data.vertices.foreach_set("co", mesh.vertices.astype(np.float32).ravel())
    data.loops.add(mesh.faces.size)
    data.loops.foreach_set("vertex_index", mesh.faces.ravel())
    data.polygons.add(len(mesh.faces))
    data.polygons.foreach_set("loop_start", np.arange(0, mesh.faces.size, 3, dtype=np.int32))
    data.update(calc_edges=True)
    ground = bpy.data.objects.new("ground", data)
    scene = bpy.context.scene
    scene.collection.objects.link(ground)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    above, down = float(mesh.bounds[1, 2]) + 1.0, Vector((0, 0, -1))
    tree = BVHTree.FromObject(ground, depsgraph)
    scene.ray_cast(depsgraph, Vector((0, 0, above)), down)  # builds

    def cast(xy: np.ndarray) -> list:
        return [scene.ray_cast(depsgraph, (x, y, above), down) for x, y in xy.tolist()]

    def cast_tree(xy: np.ndarray) -> list:
        return [tree.ray_cast((x, y, above), down) for x, y in xy.tolist()]

    return {"Blender scene.ray_cast": cast, "mathutils BVHTree": cast_tree}
