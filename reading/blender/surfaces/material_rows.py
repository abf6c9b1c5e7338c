"""Materials of a vehicle's surface: share, mean color, and whether it's paint."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float

from hulldown.geometry.color import linear_from_srgb
from hulldown.reading.blender.api.buffers import coordinates, pixels, read
from hulldown.reading.blender.surfaces.nodes import Stack, source
from hulldown.reading.blender.surfaces.shaders import BASE_COLORS, is_clear, surface_shaders
from hulldown.reading.pieces.paintable import (
    CLEAR,
    SEVERAL,
    MaterialRow,
    is_one_color,
    left_alone_by_name,
    parts_left_alone,
    told_apart,
)
from hulldown.reading.pieces.roles import Piece

METAL = 0.5  # least metalness of unpainted materials
SIDE = 512  # pixels that images are shrunk to
SAMPLES = 4096  # of an image, on each mesh
DEEPEST = 48  # nodes between a shader and the images and colors that are looked at
GRAY = 0.5  # assumed mean of unknown nodes
# Nodes that change a color little on the whole.
PASSING = ("HueSaturation", "Gamma", "BrightContrast", "RGBCurve", "MixRGB")
SOCKETS = {"RGBA": (0, 6, 7), "VECTOR": (0, 4, 5), "FLOAT": (0, 2, 3)}  # of a Mix node: factor, A, B


def material_rows(
    meshes: Sequence[Any], pieces: Sequence[Piece], piece_part: Sequence[int]
) -> tuple[tuple[MaterialRow, ...], list[bool]]:
    """Materials of the pieces with a part, largest share first, and the pieces that aren't painted.

    `pieces`, `piece_part`: the pieces, and the part of each; -1: none.
    """
    areas: dict[Any, float] = defaultdict(float)
    own: dict[int, dict[Any, float]] = {}
    used = [
        i
        for i, (piece, part) in enumerate(zip(pieces, piece_part, strict=True))
        if part >= 0 and isinstance(meshes[piece.mesh], bpy.types.Mesh)
    ]
    area, scales = np.zeros(len(used)), np.zeros(len(used))
    for k, piece in enumerate(pieces[i] for i in used):
        if piece.mesh not in own:
            own[piece.mesh] = _areas(meshes[piece.mesh])
        scale = scales[k] = abs(float(np.linalg.det(piece.pose[:3, :3]))) ** (2 / 3)
        area[k] = scale * sum(own[piece.mesh].values())
        for material, one in own[piece.mesh].items():
            areas[material] += scale * one
    left = parts_left_alone([pieces[i].name for i in used], area, [len(own[pieces[i].mesh]) for i in used])
    kept = {i for i, one in zip(used, left.tolist(), strict=True) if one}
    total = sum(areas.values()) or 1.0
    weights: dict[int, float] = defaultdict(float)
    for i, scale in zip(used, scales.tolist(), strict=True):
        weights[pieces[i].mesh] += 0.0 if i in kept else scale
    colors = _MeanColors([(meshes[i], weight) for i, weight in weights.items() if weight > 0.0])
    rows = []
    for material, one in areas.items():
        color, several = colors.of_material(material)
        why = why_left_alone(material) or (SEVERAL if several else "")
        rows.append(MaterialRow(material.name, one / total, color, why, _alpha(material)))
    rows = told_apart(rows, parts=bool(kept))
    return tuple(sorted(rows, key=lambda row: (-row.share, row.name))), [i in kept for i in range(len(pieces))]


def _areas(mesh: Any) -> dict[Any, float]:
    """Return the area of each material's faces, in the mesh's own units."""
    if not len(mesh.materials):
        return {}
    worn, area = read(mesh.polygons, "material_index", np.int32), read(mesh.polygons, "area", np.float32)
    sums = np.bincount(worn.clip(0, len(mesh.materials) - 1), weights=area, minlength=len(mesh.materials))
    found: dict[Any, float] = defaultdict(float)
    for material, one in zip(mesh.materials, sums.tolist(), strict=True):
        if material is not None and one > 0.0:
            found[material] += one
    return found


def why_left_alone(material: Any) -> str:
    """Return the reason why a material isn't painted; empty if it can be."""
    shaders = [shader for shader, _ in surface_shaders(material)]
    principled = [shader for shader in shaders if shader.type == "BSDF_PRINCIPLED"]
    if is_clear(material):
        return CLEAR
    if not any(shader.type in BASE_COLORS for shader in shaders):
        return "it has no base color"
    if principled and all(_least(shader, "Metallic") >= METAL for shader in principled):
        return "it is bare metal"
    if any(_glows(shader) for shader in shaders):
        return "it glows"
    return left_alone_by_name(material.name)


def _alpha(material: Any) -> float:
    """Return the least alpha of a material's shaders that isn't linked to anything."""
    sockets = [shader.inputs["Alpha"] for shader, _ in surface_shaders(material) if "Alpha" in shader.inputs]
    return min((float(socket.default_value) for socket in sockets if not socket.is_linked), default=1.0)


def _least(shader: Any, name: str) -> float:
    """Value of an unlinked input; 0 if something is linked to it."""
    socket = shader.inputs[name]
    return 0.0 if socket.is_linked else float(socket.default_value)


def _glows(shader: Any) -> bool:
    if shader.type == "EMISSION":
        return True
    if shader.type != "BSDF_PRINCIPLED" or shader.inputs["Emission Color"].is_linked:
        return False
    return _least(shader, "Emission Strength") > 0.0 and max(shader.inputs["Emission Color"].default_value[:3]) > 0.0


class _MeanColors:
    """Mean colors of sockets; each image is read once."""

    def __init__(self, meshes: Sequence[tuple[Any, float]]) -> None:
        self._meshes = meshes
        self._images: dict[Any, Float[np.ndarray, "h w 3"]] = {}
        self._seen: dict[tuple[int, ...], Float[np.ndarray, "3"]] = {}

    def of_material(self, material: Any) -> tuple[tuple[float, float, float], bool]:
        """Return mean color, and whether its texture has several colors where the meshes wear it."""
        found, several = [], False
        for shader, around in surface_shaders(material):
            if shader.type not in BASE_COLORS:
                continue
            socket = shader.inputs[BASE_COLORS[shader.type]]
            worn = self._worn(material, source(socket, around))
            if worn is None:
                found.append(self._of(socket, around, 0))
                continue
            several = several or not is_one_color(*worn)
            found.append(np.average(worn[0], axis=0, weights=worn[1]))
        red, green, blue = np.mean(found or [np.full(3, GRAY)], axis=0).tolist()
        return (red, green, blue), several

    def _worn(self, material: Any, found: Any) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]] | None:
        """Texels that a material uses, and their weights; None if its color isn't an image on a UV map."""
        node = found[0].node if found and found[0].is_output else None
        if node is None or node.bl_idname != "ShaderNodeTexImage" or not node.image or found[0].name != "Color":
            return None
        placed, layer = source(node.inputs["Vector"], found[1]), ""
        if placed and placed[0].node.bl_idname == "ShaderNodeUVMap":
            layer = placed[0].node.uv_map
        elif placed and placed[0].name != "UV":
            return None
        texels = self._texels(node.image)
        height, width, _ = texels.shape
        parts, weights = [texels[:0, 0]], [np.empty(0)]
        for mesh, factor in self._meshes:
            uv, area = _uv_samples(mesh, material, layer)
            x, y = (((uv % 1.0) * (width, height)).astype(int) % (width, height)).T
            parts.append(texels[y, x])
            weights.append(np.full(len(uv), factor * area))
        weight = np.concatenate(weights)
        return (np.concatenate(parts), weight) if weight.any() else None

    def _of(self, socket: Any, stack: Stack, depth: int) -> Float[np.ndarray, "3"]:
        found = source(socket, stack)
        if found is None or not found[0].is_output:
            return _three(getattr(found[0] if found else socket, "default_value", GRAY))
        output, stack = found
        key = (output.as_pointer(), *(node.as_pointer() for node in stack))
        if key not in self._seen:
            self._seen[key] = self._of_node(output, stack, depth + 1) if depth < DEEPEST else np.full(3, GRAY)
        return self._seen[key]

    def _of_node(self, output: Any, stack: Stack, depth: int) -> Float[np.ndarray, "3"]:
        node = output.node
        kind = node.bl_idname.removeprefix("ShaderNode")
        if kind == "TexImage" and node.image is not None and output.name == "Color":
            return self._texels(node.image).reshape(-1, 3).mean(axis=0)
        if kind in ("RGB", "Value"):
            return _three(output.default_value)
        if kind == "ValToRGB":
            return np.mean([node.color_ramp.evaluate(x)[:3] for x in np.linspace(0.0, 1.0, 16)], axis=0)
        if kind == "Mix":
            factor, a, b = (self._of(node.inputs[i], stack, depth) for i in SOCKETS.get(node.data_type, (0, 6, 7)))
            share = factor.mean().clip(0.0, 1.0)
            mixed = {"MULTIPLY": a * b, "MIX": b}.get(node.blend_type, a)
            return (1.0 - share) * a + share * mixed
        if kind == "VectorMath" and node.operation == "SCALE":
            scale = node.inputs["Scale"]
            return self._of(node.inputs[0], stack, depth) * (1.0 if scale.is_linked else scale.default_value)
        if kind in PASSING:
            return self._of(node.inputs[1] if kind == "MixRGB" else node.inputs["Color"], stack, depth)
        return np.full(3, GRAY)

    def _texels(self, image: Any) -> Float[np.ndarray, "h w 3"]:
        if image not in self._images:
            self._images[image] = _texels(image)
        return self._images[image]


def _uv_samples(mesh: Any, material: Any, layer: str) -> tuple[Float[np.ndarray, "k 2"], float]:
    """Return points on a UV map, evenly over the faces of a mesh that wear a material, and the area of those faces."""
    uv = coordinates(mesh, layer)
    slots = [i for i, worn in enumerate(mesh.materials) if worn == material]
    if uv is None or not slots:
        return np.empty((0, 2)), 0.0
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    area, slot = read(triangles, "area", np.float32), read(triangles, "material_index", np.int32)
    weight = np.where(np.isin(slot.clip(0, len(mesh.materials) - 1), slots), area, 0.0).astype(np.float64)
    total = float(weight.sum())
    if not total > 0.0:
        return np.empty((0, 2)), 0.0
    draws = np.random.default_rng(0)
    chosen = draws.choice(len(triangles), SAMPLES, p=weight / total)
    corners = uv[read(triangles, "loops", np.int32, 3).reshape(-1, 3)[chosen]]
    return np.einsum("kc,kcd->kd", draws.dirichlet(np.ones(3), SAMPLES), corners), total


def _three(value: Any) -> Float[np.ndarray, "3"]:
    return np.array(value[:3] if hasattr(value, "__len__") else [value] * 3, dtype=np.float64)


def _texels(image: Any) -> Float[np.ndarray, "h w 3"]:
    """Of an image, in linear light; those that are transparent have the mean of the others."""
    if not all(image.size):
        return np.full((1, 1, 3), GRAY)
    width, height = image.size
    rgba = pixels(image, (min(width, SIDE), min(height, SIDE))).astype(np.float64)
    color = rgba[..., :3]
    if image.colorspace_settings.name == "sRGB" and not image.is_float:
        color = linear_from_srgb(color)
    color = np.nan_to_num(color, nan=GRAY).clip(0.0, 1.0)
    if (opaque := rgba[..., 3] > 0.5).any():
        color[~opaque] = color[opaque].mean(axis=0)
    return color
