"""Procedural materials: paint in camouflage, steel, rubber, glass, canvas, earth, grass, rock, bark and leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from PIL import Image

from hulldown.base.color import linear_rgb_from_hex
from hulldown.base.files import atomic_writer
from hulldown.blender.add_nodes import add_node

Color = str  # "#rrggbb" as a color picker shows it
PAINT_TILE_M = 3.0  # a paint's image repeats at this width where there is no UV map


def linear_rgba(color: Color) -> tuple[float, float, float, float]:
    """Return the color in the linear light that Cycles computes with."""
    return *linear_rgb_from_hex(color), 1.0


class Graph:
    """The node tree of one new material, built from the surface backwards."""

    def __init__(self, name: str) -> None:
        self.material = bpy.data.materials.new(name)
        self.tree = self.material.node_tree
        self.tree.nodes.clear()

    def add(self, kind: str, inputs: Mapping[Any, Any] | None = None, /, **settings: Any) -> Any:
        """Return a node with inputs set to values or linked to sockets."""
        return add_node(self.tree, kind, inputs, **settings)

    def noise_socket(self, where: Any, scale: float, *, detail: float = 2.0, rough: float = 0.5, warp: float = 0.0) -> Any:
        """Fractal noise, mostly within 0.25 to 0.75."""
        inputs = {"Vector": where, "Scale": scale, "Detail": detail, "Roughness": rough, "Distortion": warp}
        return self.add("TexNoise", inputs).outputs[0]

    def cells(self, where: Any, scale: float) -> tuple[Any, Any]:
        """Cut the plane into cells, `scale` per meter: the distance from a cell's middle, and its random number."""
        node = self.add("TexVoronoi", {"Vector": where, "Scale": scale}, voronoi_dimensions="2D")
        return node.outputs["Distance"], self.add("SeparateXYZ", {0: node.outputs["Color"]}).outputs[0]

    def normal_z_socket(self) -> Any:
        """Return the upward part of the surface's normal, 1 where it's level."""
        return self.add("SeparateXYZ", {0: self.add("NewGeometry").outputs["Normal"]}).outputs[2]

    def ramp_socket(self, value: Any, low: float, high: float) -> Any:
        """0 below `low` to 1 above `high`, smoothly; falling where low > high."""
        return self.add("MapRange", {0: value, 1: low, 2: high}, interpolation_type="SMOOTHSTEP").outputs[0]

    def maths(self, operation: str, a: Any, b: Any = 0.0) -> Any:
        """Return one arithmetic operation on numbers."""
        return self.add("Math", {0: a, 1: b}, operation=operation).outputs[0]

    def mixed_color_socket(self, factor: Any, a: Any, b: Any) -> Any:
        """Return a color that turns from a into b as the factor goes from 0 to 1."""
        a, b = (linear_rgba(c) if isinstance(c, str) else c for c in (a, b))
        node = self.add("Mix", {0: factor, 6: a, 7: b}, data_type="RGBA")
        return node.outputs[2]

    def shade(self, color: Any, value: Any, amount: float) -> Any:
        """Return the color made darker and brighter by up to `amount` as a noise value goes about 0.5."""
        color = linear_rgba(color) if isinstance(color, str) else color
        factor = self.add("MapRange", {0: value, 1: 0.25, 2: 0.75, 3: 1 - amount, 4: 1 + amount}).outputs[0]
        vector = color[:3] if isinstance(color, tuple) else color
        scale = self.add("VectorMath", {0: vector, "Scale": factor}, operation="SCALE")
        return scale.outputs[0]

    def bump_normal_socket(self, height: Any, distance: float, strength: float = 1.0) -> Any:
        """Return a normal that leans as a height field of `distance` meters would."""
        return self.add("Bump", {"Height": height, "Distance": distance, "Strength": strength}).outputs[0]

    def surface(self, inputs: Mapping[Any, Any]) -> bpy.types.Material:
        """Close the tree with a principled surface."""
        shader = self.add("BsdfPrincipled", inputs)
        self.out(shader.outputs[0])
        return self.material

    def out(self, shader: Any) -> None:
        """Close the tree with any surface shader."""
        self.add("OutputMaterial", {"Surface": shader})


def plain_material(name: str, color: Color, *, rough: float = 0.6, metal: float = 0.0, mottle: float = 0.15) -> Any:
    """Return one color with slight fine variation: rubber, steel, canvas, wood, lamps."""
    g = Graph(name)
    where = g.add("TexCoord").outputs["Object"]
    value = g.noise_socket(where, 6.0, detail=4.0)
    return g.surface(
        {
            "Base Color": g.shade(color, value, mottle),
            "Roughness": g.maths("ADD", rough - 0.08, g.maths("MULTIPLY", value, 0.16)),
            "Metallic": metal,
        }
    )


def dark_glass_material() -> Any:
    """Dark window glass that mirrors the sky; opaque, as windows look from outside."""
    g = Graph("Glass")
    return g.surface({"Base Color": linear_rgba("#10181c"), "Roughness": 0.06, "Specular IOR Level": 0.9})


def camouflage_material(name: str, colors: Sequence[Color], *, dust: Color, unit: float = 1.0, size: float = 1.0) -> Any:
    """Paint in two or three colors in soft-edged patches meters wide, with wear, and dust on the lower hull."""
    g = Graph(name)
    where = _object_position_in_meters(g, unit)
    first = g.noise_socket(where, 0.55 / size, detail=1.5, warp=0.6)
    color: Any = linear_rgba(colors[0])
    edges = [(0.53, 0.555), (0.585, 0.61)]
    for k, paint in enumerate(colors[1:]):
        offset = g.add("VectorMath", {0: where, 1: (37.0 * k, 11.0 * k, 5.0)}).outputs[0]
        patch = g.ramp_socket(first if k == 0 else g.noise_socket(offset, 0.6 / size, detail=1.5, warp=0.6), *edges[k])
        color = g.mixed_color_socket(patch, color, paint)
    return _worn_paint_material(g, color, where, dust)


def image_paint_material(name: str, image: bpy.types.Image, *, dust: Color, by_uv: bool) -> Any:
    """Paint from an image texture, by UV map or box projection, with the wear and dust of `camouflage_material`."""
    g = Graph(name)
    where = _object_position_in_meters(g, 1.0)
    if by_uv:
        texture = g.add("TexImage", {"Vector": g.add("TexCoord").outputs["UV"]}, image=image)
    else:
        scaled = g.add("VectorMath", {0: where, "Scale": 1 / PAINT_TILE_M}, operation="SCALE").outputs[0]
        texture = g.add("TexImage", {"Vector": scaled}, image=image, projection="BOX", projection_blend=0.1)
    return _worn_paint_material(g, texture.outputs["Color"], where, dust)


def gloss_paint_material(color: Color, *, dust: Color) -> Any:
    """Clean car paint with a film of dust toward the ground."""
    g = Graph("Paint")
    where = _object_position_in_meters(g, 1.0)
    worn = g.noise_socket(where, 1.6, detail=4.0)
    height = g.add("SeparateXYZ", {0: where}).outputs[2]
    film = g.maths("MULTIPLY", g.ramp_socket(g.maths("ADD", height, g.maths("MULTIPLY", worn, 0.5)), 1.05, 0.3), 0.5)
    return g.surface(
        {
            "Base Color": g.mixed_color_socket(film, g.shade(color, worn, 0.05), g.shade(dust, worn, 0.3)),
            "Roughness": g.maths("ADD", 0.08, g.maths("MULTIPLY", film, 0.4)),
            "Metallic": 0.3,
            "Coat Weight": 1.0,
        }
    )


def rusted_paint_material(name: str, color: Color, *, rust: Color, share: float) -> Any:
    """Old paint through which rust breaks in blisters and runs down in streaks; `share` of it is rust."""
    g = Graph(name)
    where = _object_position_in_meters(g, 1.0)
    fine, blister = g.noise_socket(where, 14.0, detail=4.0), g.noise_socket(where, 1.7, detail=6.0, rough=0.7)
    tall = g.add("VectorMath", {0: where, 1: (6.0, 6.0, 0.35)}, operation="MULTIPLY").outputs[0]
    runs = g.noise_socket(tall, 1.0, detail=3.0, rough=0.6)
    level = 0.75 - 0.5 * share
    broken = g.ramp_socket(blister, level - 0.04, level + 0.05)
    stained = g.maths("MULTIPLY", g.ramp_socket(runs, level - 0.06, level + 0.16), 0.6)
    paint = g.shade(g.shade(color, blister, 0.22), fine, 0.12)
    iron = g.mixed_color_socket(fine, g.shade(rust, blister, 0.5), "#2c1c14")
    color_now = g.mixed_color_socket(g.maths("MAXIMUM", broken, stained), paint, iron)
    rough = g.maths("ADD", 0.55, g.maths("MULTIPLY", broken, 0.35))
    return g.surface({"Base Color": color_now, "Roughness": rough, "Normal": g.bump_normal_socket(fine, 0.004)})


def _object_position_in_meters(g: Graph, unit: float) -> Any:
    where = g.add("TexCoord").outputs["Object"]
    return where if unit == 1.0 else g.add("VectorMath", {0: where, "Scale": 1 / unit}, operation="SCALE").outputs[0]


def _worn_paint_material(g: Graph, color: Any, where: Any, dust: Color) -> bpy.types.Material:
    worn = g.noise_socket(where, 2.2, detail=5.0, rough=0.65)
    fine = g.noise_socket(where, 18.0, detail=3.0)
    tall = g.add("VectorMath", {0: where, 1: (5.0, 5.0, 0.5)}, operation="MULTIPLY").outputs[0]
    color = g.shade(g.shade(color, worn, 0.26), fine, 0.10)
    color = g.shade(color, g.noise_socket(tall, 1.0, detail=3.0, rough=0.6), 0.16)
    height = g.add("SeparateXYZ", {0: where}).outputs[2]
    low = g.maths("MULTIPLY", g.ramp_socket(height, 1.55, 0.25), g.ramp_socket(worn, 0.15, 0.65))
    mud = g.maths("MULTIPLY", g.ramp_socket(g.maths("ADD", height, worn), 1.45, 0.85), g.ramp_socket(worn, 0.38, 0.52))
    up = g.normal_z_socket()
    settled = g.maths("MULTIPLY", g.ramp_socket(up, 0.6, 1.0), g.ramp_socket(worn, 0.40, 0.75))
    film = g.maths("MULTIPLY", g.maths("MAXIMUM", low, g.maths("MULTIPLY", settled, 0.55)), 0.8)
    color = g.mixed_color_socket(
        g.maths("MULTIPLY", mud, 0.7), g.mixed_color_socket(film, color, dust), g.shade(dust, fine, 0.35)
    )
    rough = g.maths("ADD", 0.5, g.maths("MULTIPLY", worn, 0.3))
    return g.surface(
        {
            "Base Color": color,
            "Roughness": g.maths("ADD", rough, g.maths("MULTIPLY", film, 0.2)),
            "Specular IOR Level": 0.35,
            "Normal": g.bump_normal_socket(fine, 0.002),
        }
    )


def write_block_camouflage(path: Path, colors: Sequence[Color], *, rng: np.random.Generator) -> None:
    """Write a tileable image of camouflage in square blocks, the paint that `image_paint_material` uses, if it isn't there."""
    cells = 96
    height = np.zeros((cells, cells))
    for octave, weight in ((6, 1.0), (12, 0.6), (32, 0.35)):
        coarse = rng.random((octave, octave))
        height += weight * np.kron(coarse, np.ones((cells // octave, cells // octave)))
    level = np.searchsorted(np.quantile(height, np.linspace(0, 1, len(colors) + 1)[1:-1]), height)
    palette = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in colors], np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        with atomic_writer(path) as file:
            Image.fromarray(np.kron(palette[level], np.ones((8, 8, 1), np.uint8))).save(file, "PNG")
