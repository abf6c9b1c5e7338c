"""Trees, bushes, grass and boulders as real geometry, each made once and instanced thousands of times."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from jaxtyping import Float

from hulldown.demo.relief import Noise, grid_quads, smoothstep

Points = Float[np.ndarray, "n 3"]


class Plant:
    """A mesh under construction whose faces carry one of several materials."""

    def __init__(self) -> None:
        self.vertices: list[np.ndarray] = []
        self.faces: list[np.ndarray] = []
        self.slots: list[np.ndarray] = []
        self._count = 0

    def add(self, vertices: np.ndarray, faces: np.ndarray, slot: int) -> None:
        """Add faces, all quads, with the material of a slot."""
        self.vertices.append(vertices)
        self.faces.append(faces + self._count)
        self.slots.append(np.full(len(faces), slot))
        self._count += len(vertices)

    def add_limb(self, points: Points, radii: np.ndarray, *, sides: int = 7) -> None:
        """Add a branch or trunk through points, in slot 0."""
        along = np.gradient(points, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        side = np.cross(along, [0.31, 0.95, 0.05])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        angles = np.linspace(0, 2 * np.pi, sides + 1)
        ring = np.cos(angles)[:, None] * side[:, None] + np.sin(angles)[:, None] * np.cross(along, side)[:, None]
        self.add((points[:, None] + radii[:, None, None] * ring).reshape(-1, 3), grid_quads(len(points), sides + 1)[:, ::-1], 0)

    def add_leaf_sprays(self, centers: Points, along: Points, across: Points) -> None:
        """Add leaf sprays in slot 1: bent kites at `centers`, reaching `along` and `across` both ways."""
        fold = 0.25 * np.cross(along, across) / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        corners = np.stack(
            [centers - along, centers + across * 0.9 + fold, centers + along, centers - across * 0.9 + fold], axis=1
        )
        self.add(corners.reshape(-1, 3), np.arange(4 * len(centers)).reshape(-1, 4), 1)

    def mesh(self, name: str, materials: list[Any]) -> Any:
        """Return the finished Blender mesh."""
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(np.concatenate(self.vertices), [], np.concatenate(self.faces))
        for material in materials:
            mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", np.concatenate(self.slots).astype(np.int32))
        mesh.polygons.foreach_set("use_smooth", np.concatenate(self.slots) == 0)
        mesh.update()
        return mesh


def _random_directions(n: int, rng: np.random.Generator) -> Points:
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def _add_foliage(plant: Plant, center: np.ndarray, size: np.ndarray, n: int, leaf: float, rng: np.random.Generator) -> None:
    out = _random_directions(n, rng)
    at = center + out * size * (rng.random((n, 1)) ** 0.4)
    along = out + _random_directions(n, rng) * 0.9
    along *= leaf * rng.uniform(0.6, 1.1, (n, 1)) / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, _random_directions(n, rng))
    across *= leaf * 0.55 / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-6)
    plant.add_leaf_sprays(at, along, across)


def make_broadleaf_mesh(name: str, materials: list[Any], *, height: float, spread: float, rng: np.random.Generator) -> Any:
    """Return a tree with a forked trunk and a crown of clumps."""
    plant = Plant()
    fork = height * 0.32
    lean = rng.normal(0, 0.04, 2)
    t = np.linspace(-0.05, 1, 7)
    trunk = np.stack([lean[0] * height * t**2, lean[1] * height * t**2, height * 0.8 * t], axis=-1)
    trunk[1:-1, :2] += rng.normal(0, 0.012 * height, (5, 2))
    plant.add_limb(trunk, height * 0.021 * (1.25 - t) ** 0.8 * np.where(t < 0, 1.9, 1.0))
    for k in range(9):
        angle = k * 2.4 + rng.normal(0, 0.3)
        rise = rng.uniform(0.0, 1.0)
        base = np.array(
            [np.interp(fork + rise * height * 0.42, trunk[:, 2], trunk[:, i]) for i in range(2)] + [fork + rise * height * 0.42]
        )
        reach = spread * (1 - 0.55 * rise) * rng.uniform(0.75, 1.05)
        tip = base + np.array([reach * np.cos(angle), reach * np.sin(angle), height * rng.uniform(0.10, 0.2)])
        bow = np.linspace(0, 1, 4)[:, None]
        branch = base + (tip - base) * bow + np.array([0, 0, 0.10 * height]) * bow * (1 - bow)
        plant.add_limb(branch, height * 0.010 * np.linspace(1.0, 0.3, 4), sides=5)
        size = spread * rng.uniform(0.36, 0.5) * np.array([1, 1, 0.72])
        _add_foliage(plant, tip, size, 640, 0.042 * height**0.5, rng)
    for z in (0.72, 0.86):
        top = trunk[-1] * [1, 1, 0] + [0, 0, height * z] + [*rng.normal(0, 0.12 * spread, 2), 0]
        _add_foliage(plant, top, spread * (1.2 - z) * np.array([1.25, 1.25, 0.85]), 960, 0.042 * height**0.5, rng)
    return plant.mesh(name, materials)


def make_conifer_mesh(name: str, materials: list[Any], *, height: float, spread: float, rng: np.random.Generator) -> Any:
    """Return a spruce: whorls of drooping fronds that get shorter to the top."""
    plant = Plant()
    t = np.linspace(-0.03, 1, 5)
    plant.add_limb(np.stack([0 * t, 0 * t, height * t], axis=-1), height * 0.016 * (1.03 - t) + 0.01)
    levels = int(height * 2.1)
    for k in range(levels):
        rise = k / levels
        z0, reach = height * (0.10 + 0.88 * rise), spread * (1 - rise) ** 0.85 * rng.uniform(0.85, 1.1) + 0.12
        fronds = max(int(10 - 4 * rise), 5)
        for j in range(fronds):
            angle = 2 * np.pi * (j + 0.5 * (k % 2)) / fronds + rng.normal(0, 0.12)
            out = np.array([np.cos(angle), np.sin(angle), 0.0])
            side = np.array([-np.sin(angle), np.cos(angle), 0.0])
            n = int(10 + 20 * (1 - rise))
            s = np.linspace(0.12, 1, n)[:, None]
            length = reach * rng.uniform(0.85, 1.1)
            droop = -0.30 * length * s**1.3 + 0.10 * length * s**3
            stem = out * length * s + [0, 0, 1] * (z0 + droop)
            width = (0.26 * length + 0.16) * (1.15 - s) * rng.uniform(0.6, 1.3, (n, 1))
            for sign in (-1, 1):
                along = (side * sign * 0.8 + out * 0.55 + [0, 0, -0.45] + rng.normal(0, 0.25, (n, 3))) * width * 0.5
                plant.add_leaf_sprays(stem + along * 0.8, along, (out * 0.5 + [0, 0, 0.12]) * length / n * 1.5)
    return plant.mesh(name, materials)


def make_bush_mesh(
    name: str, materials: list[Any], *, height: float, rng: np.random.Generator, leaf: float = 0.11, clumps: int = 7
) -> Any:
    """Return a bush of leafy clumps on a few stems."""
    plant = Plant()
    for k in range(clumps):
        angle = k * 2.4
        foot = np.array([0.15 * np.cos(angle), 0.15 * np.sin(angle), -0.1])
        reach = height * rng.uniform(0.2, 0.6)
        tip = np.array([reach * np.cos(angle), reach * np.sin(angle), height * rng.uniform(0.45, 0.78)])
        plant.add_limb(np.linspace(foot, tip, 3), np.array([0.03, 0.02, 0.008]) * height, sides=4)
        _add_foliage(plant, tip, height * rng.uniform(0.26, 0.4) * np.array([1, 1, 0.8]), 170, 0.65 * leaf * height**0.5, rng)
    return plant.mesh(name, materials)


def make_tussock_curves(
    name: str, material: Any, *, height: float, blades: int, clumps: int, radius: float, rng: np.random.Generator
) -> Any:
    """Return clumps of grass as hair curves: seen by the camera, but nothing a vehicle could not stand on."""
    curves = bpy.data.hair_curves.new(name)
    t = np.linspace(0, 1, 4)
    curves.add_curves([len(t)] * blades)
    angle = rng.uniform(0, 2 * np.pi, clumps)
    center = radius * np.sqrt(rng.random((clumps, 1))) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    vigour = rng.uniform(0.45, 1.0, clumps)
    clump = np.arange(blades) % clumps
    away = rng.normal(0, 0.13, (blades, 2)) * vigour[clump, None]
    tall = height * vigour[clump, None] * rng.uniform(0.55, 1.1, (blades, 1))
    bend = (1.6 * away + rng.normal(0, 0.35, (blades, 2)) * height) * vigour[clump, None]
    points = np.zeros((blades, len(t), 3))
    points[..., :2] = (center[clump] + away)[:, None] + bend[:, None] * (t**2)[None, :, None]
    points[..., 2] = tall * t - 0.25 * np.linalg.norm(bend, axis=1, keepdims=True) * t**2 - 0.03
    curves.points.foreach_set("position", points.ravel().astype(np.float32))
    radii = np.tile(0.009 * (1.05 - t), blades)
    curves.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", radii.astype(np.float32))
    curves.materials.append(material)
    return curves


def make_boulder_mesh(name: str, material: Any, *, flat: float, rng: np.random.Generator) -> Any:
    """Return a weathered block about a meter in radius, sunk a little."""
    noise = Noise(rng)
    lat, lon = np.linspace(-np.pi / 2, np.pi / 2, 15), np.linspace(0, 2 * np.pi, 25)
    a, b = np.meshgrid(lat, lon[:-1], indexing="ij")
    unit = np.stack([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)], axis=-1)
    # A few random planes cut the ball into facets.
    cuts, depth = _random_directions(9, rng), rng.uniform(0.62, 0.95, 9)
    reach = np.min(depth / np.maximum(unit @ cuts.T, 0.25), axis=-1)
    reach = np.minimum(reach, 1.0) + 0.06 * noise(unit[..., 0] + 3 * unit[..., 2], unit[..., 1], 0.45, octaves=3)
    reach[[0, -1]] = reach[[0, -1]].mean(axis=1, keepdims=True)
    vertices = (unit * reach[..., None]) * [1, 1, flat]
    vertices[..., 2] += 0.3 * flat * smoothstep(vertices[..., 2], -1.0, 1.0)
    mesh = bpy.data.meshes.new(name)
    rows, columns = len(lat), len(lon) - 1
    faces = [
        (i * columns + j, i * columns + (j + 1) % columns, (i + 1) * columns + (j + 1) % columns, (i + 1) * columns + j)
        for i in range(rows - 1)
        for j in range(columns)
    ]
    mesh.from_pydata(vertices.reshape(-1, 3), [], faces)
    mesh.materials.append(material)
    mesh.shade_smooth()
    return mesh
