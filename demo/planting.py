"""Plants, stones, and grass of both demo sceneries, as copies, in groups by empties, and by geometry nodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

from hulldown.demo import earth, vegetation
from hulldown.demo.land import Land
from hulldown.demo.materials import Color
from hulldown.demo.relief import Height

PlantDensity = Callable[[np.ndarray, np.ndarray], np.ndarray]  # how likely a plant stands at x, y: 0 to 1
MIN_PLANTED_COSINE = 0.8  # geometry nodes strew nothing on ground that is steeper


@dataclass(frozen=True, eq=False, slots=True)
class Planting:
    """A scenery whose ground is finished: `top` is its height, `rng` selects the places."""

    land: Land
    top: Height
    rng: np.random.Generator

    def strew_copies(
        self,
        home: str,
        kinds: Sequence[Any],
        n: int,
        share: PlantDensity,
        *,
        gap: float,
        scale: tuple[float, float],
        sink: float,
        tilt: float = 0.05,
        lying: bool = False,
    ) -> None:
        """Add up to n copies of these meshes or curves to the collection `home`, at least `gap` meters apart."""
        self._add_copies(
            home, kinds, self._random_spots(self.land.half, n, share, gap=gap), scale, sink, tilt=tilt, lying=lying
        )

    def add_stones(self, name: str, material: Any, flats: Sequence[float], n: int, share: PlantDensity) -> list[Any]:
        """Add up to n stones of these shapes, and ten boulders that are larger; return their meshes."""
        kinds = [vegetation.make_boulder_mesh(f"{name}_{k}", material, flat=flat, rng=self.rng) for k, flat in enumerate(flats)]
        self.strew_copies("Rocks", kinds, n, share, gap=4.0, scale=(0.2, 1.35), sink=0.1, tilt=0.3)
        few = self._random_spots(0.8 * self.land.half, 10, share, gap=30.0)
        for boulder in self._add_copies("Rocks", kinds, few, (1.5, 2.5), 0.4, tilt=0.2):
            finer = boulder.modifiers.new("Subdivision", "SUBSURF")
            finer.levels, finer.render_levels = 1, 2
        return kinds

    def add_grass(
        self, name: str, tones: tuple[Color, Color], heights: Sequence[float], n: int, share: PlantDensity, *, clumps: int
    ) -> None:
        """Add patches of grass some meters wide that lie on the ground, `clumps` in each."""
        blades = earth.leaf_material(f"{name}_Blades", tones)
        patches = [
            vegetation.make_tussock_curves(
                f"{name}_{k}", blades, height=height, blades=22 * clumps, clumps=clumps, radius=4.5, rng=self.rng
            )
            for k, height in enumerate(heights)
        ]
        self.strew_copies("Grass", patches, n, share, gap=4.0, scale=(0.75, 1.3), sink=0.02, lying=True)

    def plant_outskirts(
        self, name: str, plants: Sequence[Any], n: int, share: PlantDensity, *, reach: float, group: int
    ) -> None:
        """Plant groups on the surroundings, `reach` meters from the middle and farther than the ground's edge."""
        spots = self._random_spots(reach, n, share, gap=12.0, inside=self.land.half + 10)
        members = bpy.data.collections.new(name)
        angles = np.arange(group) * 2.4
        away = 7.5 * np.sqrt((np.arange(group) + 0.5) / group)
        for k, (a, r) in enumerate(zip(angles, away, strict=True)):
            data = plants[k % len(plants)]
            thing = bpy.data.objects.new(f"{data.name}_in_{name}_{k}", data)
            thing.matrix_world = (
                Matrix.Translation((r * np.cos(a), r * np.sin(a), self.rng.uniform(-0.3, 0)))
                @ Euler((0, 0, self.rng.uniform(0, 6.28))).to_matrix().to_4x4()
                @ Matrix.Scale(float(self.rng.uniform(0.75, 1.15)), 4)
            )
            members.objects.link(thing)
        home = self.land.collection(f"{name}_Instances")
        for k, (x, y) in enumerate(spots):
            empty = bpy.data.objects.new(f"{name}.{k:03d}", None)
            empty.instance_type, empty.instance_collection = "COLLECTION", members
            around = self.land.outland(x + away * np.cos(angles), y + away * np.sin(angles))
            empty.location = (x, y, float(around.min()))
            empty.rotation_euler = (0, 0, self.rng.uniform(0, 2 * np.pi))
            empty.scale = (size := float(self.rng.uniform(0.85, 1.2)), size, size)
            home.objects.link(empty)

    def add_undergrowth(
        self, ground: Any, name: str, data: Any, *, size: float, density: float, scale: tuple[float, float]
    ) -> None:
        """Let geometry nodes put copies of one mesh on one ground mesh where it is level."""
        plant = bpy.data.objects.new(name, data)
        plant.scale = (size, size, size)
        _scatter_by_geometry_nodes(ground, plant, density=density, seed=int(self.rng.integers(1000)), scale=scale)

    def _random_spots(self, half: float, n: int, share: PlantDensity, *, gap: float, inside: float = 0.0) -> np.ndarray:
        """Return up to n places (k, 2) in the square of side 2 * half, outside that of `inside`, `gap` apart."""
        xy = self.rng.uniform(-half, half, (6 * n, 2))
        xy = xy[(np.abs(xy).max(axis=1) >= inside) & (self.rng.random(len(xy)) < share(xy[:, 0], xy[:, 1]))]
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

    def _add_copies(
        self,
        home: str,
        kinds: Sequence[Any],
        xy: np.ndarray,
        scale: tuple[float, float],
        sink: float,
        *,
        tilt: float,
        lying: bool = False,
    ) -> list[Any]:
        """Add an object at each place; a `lying` one leans as the ground does, others by a random `tilt` in radians."""
        x, y = xy.T
        top, things = self.top, []
        z = top(x, y) - sink
        slope = [top(x + 1, y) - top(x - 1, y), top(x, y + 1) - top(x, y - 1)] if lying else [0 * x, 0 * y]
        normal = np.stack([*(-0.5 * rise for rise in slope), np.ones(len(xy))], axis=-1)
        for k, (east, north) in enumerate(xy):
            data = kinds[int(self.rng.integers(len(kinds)))]
            thing = bpy.data.objects.new(f"{data.name}.{k:04d}", data)
            size = self.rng.uniform(*scale)
            thing.location = (east, north, z[k])
            turn = Euler((*self.rng.normal(0, tilt, 2), self.rng.uniform(0, 2 * np.pi))).to_quaternion()
            lean = Vector((0, 0, 1)).rotation_difference(Vector(normal[k]))
            thing.rotation_euler = (lean @ turn).to_euler()
            thing.scale = size * self.rng.uniform(0.88, 1.12, 3)
            self.land.collection(home).objects.link(thing)
            things.append(thing)
        return things


def _scatter_by_geometry_nodes(ground: Any, plant: Any, *, density: float, seed: int, scale: tuple[float, float]) -> None:
    tree = bpy.data.node_groups.new(f"Scatter_{ground.name}", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    made = bpy.data.collections.new(f"Scatter_Source_{ground.name}")
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
    flat.inputs[1].default_value = MIN_PLANTED_COSINE
    noise = node("ShaderNodeTexNoise", Scale=0.03, Detail=3.0).outputs[0]
    thin = node("ShaderNodeMapRange", Value=noise, From_Min=0.45, From_Max=0.7, To_Min=0.0, To_Max=density).outputs[0]
    points = node("GeometryNodeDistributePointsOnFaces", Mesh=source, Selection=flat.outputs[0], Density=thin, Seed=seed)
    pool = node("GeometryNodeCollectionInfo", Collection=made, Separate_Children=True, Reset_Children=True).outputs[0]
    turn = _add_random_value_node(tree, "FLOAT_VECTOR", (0, 0, 0), (0, 0, 6.28))
    size = _add_random_value_node(tree, "FLOAT", *scale)
    euler = node("FunctionNodeEulerToRotation", Euler=turn).outputs[0]
    placed = node(
        "GeometryNodeInstanceOnPoints", Points=points.outputs[0], Instance=pool, Pick_Instance=True, Rotation=euler, Scale=size
    )
    join = tree.nodes.new("GeometryNodeJoinGeometry")
    tree.links.new(placed.outputs[0], join.inputs[0])
    tree.links.new(source, join.inputs[0])
    node("NodeGroupOutput", Geometry=join.outputs[0])
    ground.modifiers.new("Scatter", "NODES").node_group = tree


def _add_random_value_node(tree: bpy.types.NodeTree, kind: str, low: object, high: object) -> bpy.types.NodeSocket:
    """Add random values in a range; Blender 5.0 gives the node sockets of every kind and enables those of its own."""
    new = tree.nodes.new("FunctionNodeRandomValue")
    new.data_type = kind
    least, most = [socket for socket in new.inputs if socket.enabled][:2]
    least.default_value, most.default_value = low, high
    return next(socket for socket in new.outputs if socket.enabled)
