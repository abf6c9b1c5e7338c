"""Where plants and stones stand in a demo scenery, and the three ways they get there: copies, groups, nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

from hulldown.demo.relief import Height

Share = Callable[[np.ndarray, np.ndarray], np.ndarray]  # how likely a plant stands at x, y: 0 to 1


def spots(
    half: float, n: int, share: Share, *, gap: float, rng: np.random.Generator, inside: float = 0.0
) -> np.ndarray:
    """Up to n places (k, 2) within the square of side 2 * half, outside that of `inside`, at least `gap` apart."""
    xy = rng.uniform(-half, half, (6 * n, 2))
    xy = xy[(np.abs(xy).max(axis=1) >= inside) & (rng.random(len(xy)) < share(xy[:, 0], xy[:, 1]))]
    taken: dict[tuple[int, int], list[np.ndarray]] = {}
    chosen: list[np.ndarray] = []
    for point in xy:
        i, j = int(point[0] // gap), int(point[1] // gap)
        near = (p for a in (i - 1, i, i + 1) for b in (j - 1, j, j + 1) for p in taken.get((a, b), []))
        if all((p[0] - point[0]) ** 2 + (p[1] - point[1]) ** 2 >= gap * gap for p in near):
            taken.setdefault((i, j), []).append(point)
            chosen.append(point)
            if len(chosen) == n:
                break
    return np.array(chosen).reshape(-1, 2)


def copies(
    collection: Any,
    datas: Sequence[Any],
    xy: np.ndarray,
    height: Height,
    *,
    scale: tuple[float, float],
    sink: float,
    rng: np.random.Generator,
    tilt: float = 0.05,
    lying: bool = False,
    modifier: Callable[[Any], None] | None = None,
) -> None:
    """One object for each place, sharing the mesh of its kind; unevenly scaled a little and turned at random.

    What is `lying` leans as the ground does; all else grows upright, but for a random `tilt` in radians.
    """
    x, y = xy.T
    z = height(x, y) - sink
    slope = [height(x + 1, y) - height(x - 1, y), height(x, y + 1) - height(x, y - 1)] if lying else [0 * x, 0 * y]
    normal = np.stack([*(-0.5 * rise for rise in slope), np.ones(len(xy))], axis=-1)
    for k, (east, north) in enumerate(xy):
        data = datas[int(rng.integers(len(datas)))]
        thing = bpy.data.objects.new(f"{data.name}.{k:04d}", data)
        size = rng.uniform(*scale)
        thing.location = (east, north, z[k])
        turn = Euler((*rng.normal(0, tilt, 2), rng.uniform(0, 2 * np.pi))).to_quaternion()
        lean = Vector((0, 0, 1)).rotation_difference(Vector(normal[k]))
        thing.rotation_euler = (lean @ turn).to_euler()
        thing.scale = size * rng.uniform(0.88, 1.12, 3)
        if modifier:
            modifier(thing)
        collection.objects.link(thing)


def subdivided(thing: Any) -> None:
    """A subdivision modifier that is finer in renders than on the screen."""
    modifier = thing.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels, modifier.render_levels = 1, 2


def groups(
    scene: Any,
    name: str,
    datas: Sequence[Any],
    xy: np.ndarray,
    height: Height,
    *,
    members: int,
    radius: float,
    rng: np.random.Generator,
) -> None:
    """A collection of a few plants close together, instanced at each place by an empty."""
    group = bpy.data.collections.new(name)
    angles = np.arange(members) * 2.4
    reach = radius * np.sqrt((np.arange(members) + 0.5) / members)
    for k, (a, r) in enumerate(zip(angles, reach, strict=True)):
        data = datas[k % len(datas)]
        thing = bpy.data.objects.new(f"{data.name}_in_{name}_{k}", data)
        thing.matrix_world = (
            Matrix.Translation((r * np.cos(a), r * np.sin(a), rng.uniform(-0.3, 0)))
            @ Euler((0, 0, rng.uniform(0, 6.28))).to_matrix().to_4x4()
            @ Matrix.Scale(float(rng.uniform(0.75, 1.15)), 4)
        )
        group.objects.link(thing)
    home = bpy.data.collections.new(f"{name}_Instances")
    scene.collection.children.link(home)
    for k, (x, y) in enumerate(xy):
        empty = bpy.data.objects.new(f"{name}.{k:03d}", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", group
        around = height(x + reach * np.cos(angles), y + reach * np.sin(angles))
        empty.location = (x, y, float(around.min()))
        empty.rotation_euler = (0, 0, rng.uniform(0, 2 * np.pi))
        empty.scale = (size := float(rng.uniform(0.85, 1.2)), size, size)
        home.objects.link(empty)


def by_nodes(
    ground: Any, plants: Sequence[Any], *, density: float, seed: int, scale: tuple[float, float], level: float = 0.8
) -> None:
    """Scatter objects over a ground mesh with a geometry nodes modifier, only where it is level enough."""
    tree = bpy.data.node_groups.new(f"Scatter_{ground.name}", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    made = bpy.data.collections.new(f"Scatter_Source_{ground.name}")
    for plant in plants:
        made.objects.link(plant)

    def node(kind: str, **inputs: Any) -> Any:
        new = tree.nodes.new(kind)
        for key, value in inputs.items():
            socket = new.inputs[key.replace("_", " ")]
            if isinstance(value, bpy.types.NodeSocket):
                tree.links.new(value, socket)
            else:
                socket.default_value = value
        return new

    source = node("NodeGroupInput").outputs[0]
    up = node("ShaderNodeSeparateXYZ", Vector=node("GeometryNodeInputNormal").outputs[0]).outputs[2]
    flat = tree.nodes.new("FunctionNodeCompare")
    flat.operation = "GREATER_THAN"
    tree.links.new(up, flat.inputs[0])
    flat.inputs[1].default_value = level
    noise = node("ShaderNodeTexNoise", Scale=0.03, Detail=3.0).outputs[0]
    thin = node("ShaderNodeMapRange", Value=noise, From_Min=0.45, From_Max=0.7, To_Min=0.0, To_Max=density).outputs[0]
    points = node(
        "GeometryNodeDistributePointsOnFaces", Mesh=source, Selection=flat.outputs[0], Density=thin, Seed=seed
    )
    pool = node("GeometryNodeCollectionInfo", Collection=made, Separate_Children=True, Reset_Children=True).outputs[0]
    turn = _random(tree, "FLOAT_VECTOR", (0, 0, 0), (0, 0, 6.28))
    size = _random(tree, "FLOAT", *scale)
    euler = node("FunctionNodeEulerToRotation", Euler=turn).outputs[0]
    placed = node(
        "GeometryNodeInstanceOnPoints",
        Points=points.outputs[0],
        Instance=pool,
        Pick_Instance=True,
        Rotation=euler,
        Scale=size,
    )
    join = tree.nodes.new("GeometryNodeJoinGeometry")
    tree.links.new(placed.outputs[0], join.inputs[0])
    tree.links.new(source, join.inputs[0])
    node("NodeGroupOutput", Geometry=join.outputs[0])
    ground.modifiers.new("Scatter", "NODES").node_group = tree


def _random(tree: bpy.types.NodeTree, kind: str, low: object, high: object) -> bpy.types.NodeSocket:
    """Random values in a range. Blender 5.0 gives the node sockets of every kind and enables those of its own."""
    new = tree.nodes.new("FunctionNodeRandomValue")
    new.data_type = kind
    least, most = [socket for socket in new.inputs if socket.enabled][:2]
    least.default_value, most.default_value = low, high
    return next(socket for socket in new.outputs if socket.enabled)
