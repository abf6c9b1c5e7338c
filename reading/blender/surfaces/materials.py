"""What a vehicle's surface is of: each material's share of it, its mean colour, and whether it is paint."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float

from hulldown.geometry.color import linear_from_srgb
from hulldown.reading.blender.surfaces.nodes import Stack, source
from hulldown.reading.blender.surfaces.shaders import is_clear, surface_shaders
from hulldown.reading.roles import Piece
from hulldown.reading.vehicle.paintable import CLEAR, MaterialRow, left_alone_by_name

BASE_COLOURS = {"BSDF_PRINCIPLED": "Base Color", "BSDF_DIFFUSE": "Color"}  # by shader, the input that has it
METAL = 0.5  # least metalness of what is not painted
SIDE = 128  # pixels that images are shrunk to
DEEPEST = 48  # nodes between a shader and the images and colours that are looked at
GREY = 0.5  # what is taken for the mean of nodes that are not understood
# Nodes that change a colour little on the whole.
PASSING = ("HueSaturation", "Gamma", "BrightContrast", "RGBCurve", "MixRGB")
SOCKETS = {"RGBA": (0, 6, 7), "VECTOR": (0, 4, 5), "FLOAT": (0, 2, 3)}  # of a Mix node: factor, A, B


def material_rows(meshes: Sequence[Any], pieces: Sequence[Piece], piece_part: Sequence[int]) -> tuple[MaterialRow, ...]:
    """The materials of the pieces whose part is not -1, the largest share first.

    Parameters
    ----------
    meshes
        Blender's, in the order of `Piece.mesh`, with their materials.
    pieces, piece_part
        What is drawn, and the part that each is of.
    """
    areas: dict[Any, float] = defaultdict(float)
    own: dict[int, dict[Any, float]] = {}
    for piece, part in zip(pieces, piece_part, strict=True):
        if part < 0 or not isinstance(meshes[piece.mesh], bpy.types.Mesh):
            continue
        if piece.mesh not in own:
            own[piece.mesh] = _areas(meshes[piece.mesh])
        scale = abs(float(np.linalg.det(piece.pose[:3, :3]))) ** (2 / 3)
        for material, area in own[piece.mesh].items():
            areas[material] += scale * area
    total = sum(areas.values()) or 1.0
    colours = _MeanColours()
    rows = [
        MaterialRow(material.name, area / total, colours.of_material(material), why_left_alone(material))
        for material, area in areas.items()
    ]
    return tuple(sorted(rows, key=lambda row: (-row.share, row.name)))


def _areas(mesh: Any) -> dict[Any, float]:
    """The area of each material's faces, in the mesh's own units."""
    if not len(mesh.materials):
        return {}
    worn, area = np.empty(len(mesh.polygons), np.int32), np.empty(len(mesh.polygons), np.float32)
    mesh.polygons.foreach_get("material_index", worn)
    mesh.polygons.foreach_get("area", area)
    sums = np.bincount(worn.clip(0, len(mesh.materials) - 1), weights=area, minlength=len(mesh.materials))
    found: dict[Any, float] = defaultdict(float)
    for material, one in zip(mesh.materials, sums.tolist(), strict=True):
        if material is not None and one > 0.0:
            found[material] += one
    return found


def why_left_alone(material: Any) -> str:
    """Why a material is not painted; empty if it can be."""
    shaders = [shader for shader, _ in surface_shaders(material)]
    principled = [shader for shader in shaders if shader.type == "BSDF_PRINCIPLED"]
    if is_clear(material):
        return CLEAR
    if not any(shader.type in BASE_COLOURS for shader in shaders):
        return "it has no base colour"
    if principled and all(_least(shader, "Metallic") >= METAL for shader in principled):
        return "it is bare metal"
    if any(_glows(shader) for shader in shaders):
        return "it glows"
    return left_alone_by_name(material.name)


def _least(shader: Any, name: str) -> float:
    """What an input has all over; 0 if something is linked to it."""
    socket = shader.inputs[name]
    return 0.0 if socket.is_linked else float(socket.default_value)


def _glows(shader: Any) -> bool:
    if shader.type == "EMISSION":
        return True
    if shader.type != "BSDF_PRINCIPLED" or shader.inputs["Emission Color"].is_linked:
        return False
    return _least(shader, "Emission Strength") > 0.0 and max(shader.inputs["Emission Color"].default_value[:3]) > 0.0


class _MeanColours:
    """Means of what is linked to sockets; looks at each image once."""

    def __init__(self) -> None:
        self._images: dict[Any, Float[np.ndarray, "3"]] = {}
        self._seen: dict[tuple[int, ...], Float[np.ndarray, "3"]] = {}

    def of_material(self, material: Any) -> tuple[float, float, float]:
        found = [
            self._of(shader.inputs[BASE_COLOURS[shader.type]], around, 0)
            for shader, around in surface_shaders(material)
            if shader.type in BASE_COLOURS
        ]
        red, green, blue = np.mean(found or [np.full(3, GREY)], axis=0).tolist()
        return red, green, blue

    def _of(self, socket: Any, stack: Stack, depth: int) -> Float[np.ndarray, "3"]:
        found = source(socket, stack)
        if found is None or not found[0].is_output:
            return _three(getattr(found[0] if found else socket, "default_value", GREY))
        output, stack = found
        key = (output.as_pointer(), *(node.as_pointer() for node in stack))
        if key not in self._seen:
            self._seen[key] = self._of_node(output, stack, depth + 1) if depth < DEEPEST else np.full(3, GREY)
        return self._seen[key]

    def _of_node(self, output: Any, stack: Stack, depth: int) -> Float[np.ndarray, "3"]:
        node = output.node
        kind = node.bl_idname.removeprefix("ShaderNode")
        if kind == "TexImage" and node.image is not None and output.name == "Color":
            return self._of_image(node.image)
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
        return np.full(3, GREY)

    def _of_image(self, image: Any) -> Float[np.ndarray, "3"]:
        if image not in self._images:
            self._images[image] = _image_mean(image)
        return self._images[image]


def _three(value: Any) -> Float[np.ndarray, "3"]:
    return np.array(value[:3] if hasattr(value, "__len__") else [value] * 3, dtype=np.float64)


def _image_mean(image: Any) -> Float[np.ndarray, "3"]:
    """Of an image's opaque pixels, in linear light; grey if it cannot be read."""
    if not all(image.size):
        return np.full(3, GREY)
    small = image.copy()
    try:
        small.scale(*(min(side, SIDE) for side in image.size))
        width, height = small.size
        flat = np.empty(width * height * small.channels, dtype=np.float32)
        small.pixels.foreach_get(flat)
    finally:
        bpy.data.images.remove(small)
    pixels = flat.reshape(width * height, -1).astype(np.float64)
    if pixels.shape[1] == 4 and (opaque := pixels[:, 3] > 0.5).any():
        pixels = pixels[opaque]
    colour = pixels[:, :3] if pixels.shape[1] >= 3 else np.repeat(pixels[:, :1], 3, axis=1)
    if image.colorspace_settings.name == "sRGB" and not image.is_float:
        colour = linear_from_srgb(colour)
    return np.nan_to_num(colour.mean(axis=0), nan=GREY).clip(0.0, 1.0)
