"""Boxes, and vehicles and sceneries made of a few meshes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import Articulation, VehicleShape
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.geometry.transforms import axis_rotation, transform_points

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
FACES = np.array([face for a, b, c, d in QUADS for face in ([a, b, c], [a, c, d])])
PARTS = ("hull", "turret", "gun")
AXES = np.array([[0, 0, 1.0], [0, 0, 1.0], [0, -1.0, 0]])
LIMITS = np.array([[0, 0], [-np.pi, np.pi], [-0.1, 0.35]])


def vertices_at(shape: VehicleShape, articulation: Articulation) -> np.ndarray:
    """All vertices (v, 3) in the vehicle frame with the parts turned."""
    poses = shape.vehicle_from_parts(articulation)[shape.vertex_part]
    return transform_points(poses, shape.mesh.vertices[:, None])[:, 0]


def box(low, high, name: str = "mesh") -> Mesh:
    low, high = np.array(low, float), np.array(high, float)
    return Mesh(low + CORNERS * (high - low), FACES, name)


def sheet(low, high, z: float = 0.0) -> Mesh:
    """A level rectangle."""
    x, y = np.array([low, high], float).T
    return surface(x, y, np.full((2, 2), z), "sheet")


def plane_mesh(gradient, z: float, half=(30.0, 30.0)) -> Mesh:
    """A rectangle of two triangles that rise by this gradient along x and y."""
    x, y = np.outer(half, [-1.0, 1.0])
    return surface(x, y, z + np.add.outer(gradient[0] * x, gradient[1] * y), "plane")


def surface(x: np.ndarray, y: np.ndarray, z: np.ndarray, name: str = "surface") -> Mesh:
    """Quads between the points of x (n,) and y (m,) at heights z (n, m), each split along its diagonal."""
    i = np.arange(z.size).reshape(z.shape)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(np.column_stack([np.repeat(x, len(y)), np.tile(y, len(x)), z.ravel()]), faces, name)


def random_rotations(rng: np.random.Generator, n: int) -> np.ndarray:
    """Matrices (n, 3, 3) of rotations by any angle about any axis."""
    axes = rng.normal(size=(n, 3))
    return axis_rotation(axes / np.linalg.norm(axes, axis=1, keepdims=True), rng.uniform(-np.pi, np.pi, n))


def vehicle_of(*meshes: Mesh, name: str = "box", pivots=((0.0, 0.0, 0.0),) * 3) -> VehicleShape:
    """A vehicle of a hull, a turret on it, and a gun on that: one part per mesh."""
    parts = len(meshes)
    return VehicleShape(
        name=name,
        mesh=merge_meshes_with_sources(meshes, name=name)[0],
        vertex_part=np.repeat(np.arange(parts), [len(mesh.vertices) for mesh in meshes]),
        part_names=PARTS[:parts],
        part_parent=np.arange(parts) - 1,
        part_pivot=np.array(pivots, float)[:parts],
        part_axis=AXES[:parts],
        part_limits=LIMITS[:parts],
        vehicle_from_file=np.eye(4),
    )


def scenery_of(
    name: str, ground: Mesh | None = None, *, origin=(0.0, 0.0, 0.0), obstacles: Sequence[Mesh] = (), which=(), poses=()
) -> Scenery:
    """A scenery with obstacle `which[k]` at `poses[k]`; without `ground`, the fallback plane."""
    count = len(which)
    return Scenery(
        name=name,
        origin=np.array(origin, float),
        ground=ground,
        ground_names=() if ground is None else ("ground",),
        obstacle_meshes=tuple(obstacles),
        instance_mesh=np.array(which, dtype=np.int64),
        world_from_instance=np.array(poses, float).reshape(-1, 4, 4),
        instance_names=tuple(f"tree {k}" for k in range(count)),
        instance_gives_way=np.zeros(count, dtype=bool),
        instance_is_water=np.zeros(count, dtype=bool),
        scenery_from_file=np.eye(4),
    )
