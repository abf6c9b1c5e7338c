"""A scenery's .blend file under construction: ground, roads, the far surroundings, hills."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from hulldown.demo.relief import Course, Height, grid_quads, grid_vertices_and_quads, ribbon_vertices_and_quads, smoothstep

LAND_REACH_M = 4500.0  # the surroundings end here, below the horizon's haze
HIDDEN_EDGE_M = 4.0  # surroundings reach this far below the ground, so that no gap shows between them


class Land:
    """A scenery's file under construction, its ground a square of side `2 * half` about the origin."""

    def __init__(self, half: float) -> None:
        self.half = half
        self.outland: Height = lambda x, y: 0 * x
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self.collections: dict[str, bpy.types.Collection] = {}

    def collection(self, name: str) -> bpy.types.Collection:
        """Return the collection of that name, made when first asked for."""
        if name not in self.collections:
            self.collections[name] = bpy.data.collections.new(name)
            self.scene.collection.children.link(self.collections[name])
        return self.collections[name]

    def add(self, name: str, geometry: tuple[np.ndarray, np.ndarray], material: Any, *, home: str) -> Any:
        """Return a smooth mesh object."""
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(geometry[0], [], geometry[1])
        mesh.materials.append(material)
        mesh.shade_smooth()
        thing = bpy.data.objects.new(name, mesh)
        self.collection(home).objects.link(thing)
        return thing

    def add_road(self, name: str, course: Course, z: np.ndarray, material: Any, *, half: float) -> None:
        """Add a strip with ruts in its shape and (across, along) in meters as UV map; its edges dip into the ground."""
        across = np.array([-half, -half + 0.6, -1.4, -0.95, -0.5, 0.5, 0.95, 1.4, half - 0.6, half])
        rise = np.array([-0.25, 0.0, 0.03, -0.03, 0.03, 0.03, -0.03, 0.03, 0.0, -0.25])
        thing = self.add(name, ribbon_vertices_and_quads(course, z, across, rise), material, home="Terrain")
        uv = np.stack(np.broadcast_arrays(across[None], course.at[:, None]), axis=-1).reshape(-1, 2)
        corners = grid_quads(len(course.xy), len(across)).ravel()
        thing.data.uv_layers.new(name="UVMap").uv.foreach_set("vector", uv[corners].astype(np.float32).ravel())

    def add_surroundings(self, ground: Height, mountains: Height, material: Any, *, rise: tuple[float, float]) -> None:
        """Eight sheets of ground around the square, coarser outwards, that rise to the horizon's height in meters."""
        half = self.half

        def outland(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            away = np.maximum(np.abs(x), np.abs(y)) - half
            near = ground(x, y) * smoothstep(away, 450.0, 0.0) - 0.35
            return near + smoothstep(away, *rise) * mountains(x, y)

        self.outland = outland
        out = half - HIDDEN_EDGE_M + (LAND_REACH_M - half) * (np.linspace(0, 1, 36) ** 2.6)
        inner = np.linspace(-half + HIDDEN_EDGE_M, half - HIDDEN_EDGE_M, 41)
        spans = {"West": -out[::-1], "": inner, "East": out}
        for east, xs in spans.items():
            for north, ys in {"South": -out[::-1], "": inner, "North": out}.items():
                if east or north:
                    self.add(f"Horizon_{north}{east}", grid_vertices_and_quads(xs, ys, outland), material, home="Surroundings")

    def camera(self, at: tuple[float, float, float], turn_deg: float) -> None:
        """Add the camera that the file is delivered with."""
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        camera.matrix_world = (
            Matrix.Translation(at) @ Matrix.Rotation(np.radians(turn_deg), 4, "Z") @ Matrix.Rotation(np.radians(84), 4, "X")
        )
        camera.data.clip_end = 2 * LAND_REACH_M
        self.scene.collection.objects.link(camera)
        self.scene.camera = camera

    def save(self, path: Path) -> Path:
        """Write the file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
        return path


def surface_leveled_along_road(surface: Height, course: Course, level: np.ndarray, *, reach: tuple[float, float]) -> Height:
    """Bring a surface to the `level` of a road along its course: wholly and not at all within `reach` meters."""

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        distance, nearest = course.nearest(x, y)
        z = surface(x, y)
        return z + (level[nearest] - 0.06 - z) * smoothstep(distance, reach[1], reach[0])

    return height


def upper_envelope(*surfaces: Height) -> Height:
    """Return the top of several surfaces."""
    return lambda x, y: np.max([surface(x, y) for surface in surfaces], axis=0)


def surface_with_mound(
    center: tuple[float, float], half: tuple[float, float], turn_deg: float, top: float, base: Height, *, steep: float
) -> Height:
    """Return a hill over `base` that dips below it at its rim; its far side is `steep` times as steep."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = (x - center[0]) * c + (y - center[1]) * s, -(x - center[0]) * s + (y - center[1]) * c
        v = np.where(v > 0, v * steep, v)
        rim = np.sqrt((u / half[0]) ** 2 + (v / half[1]) ** 2)
        return base(x, y) + top * smoothstep(rim, 1.0, 0.0) - 1.5 * smoothstep(rim, 0.82, 1.0)

    return height


def patch_vertices_and_quads(center: tuple[float, float], reach: float, height: Height) -> tuple[np.ndarray, np.ndarray]:
    """Return a square sheet about a center, of lines 2 m apart."""
    line = np.linspace(-reach, reach, int(reach) + 1)
    return grid_vertices_and_quads(center[0] + line, center[1] + line, height)
