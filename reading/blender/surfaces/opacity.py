"""The image lookup that the opacity of a material is a function of, from the node tree.

Cycles lets a ray through what Transparent BSDFs leave of a surface. All other shaders stop it, whatever they do with
light. So the opacity of a surface is 1 for those and 0 for Transparent, Principled has its own, and mixes mix it.
A lookup keeps every texel where a texture repeats, and needs no picture of its own, which takes 420 ms for 1024 x 1024.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mathutils import Euler, Matrix

from hulldown.base.color import LUMINANCE_WEIGHTS, linear_from_srgb, srgb_from_linear
from hulldown.blender.buffers import image_pixels
from hulldown.blender.nodes import Stack, material_output_node, socket_source_and_stack
from hulldown.blender.shaders import TRANSPARENT_SHADER, surface_shaders_and_stacks
from hulldown.geometry.alpha import AlphaMap, Extension

MAX_READ_PIXELS = 1 << 26  # Blender shrinks larger images first
IDENTITY_AFFINE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
Affine = tuple[tuple[float, float, float], tuple[float, float, float]]
# Nodes that make of a gray value what they make of each color's luminance.
OF_GRAY = ("Emission", "Math", "Mix", "MapRange", "Clamp", "Invert", "RGBToBW", "Value", "RGB")


class NotUnderstoodError(Exception):
    """Raised for a node tree that is more than one lookup."""


@dataclass(frozen=True, slots=True)
class Lookup:
    """An image, one of its channels, and how it's looked up."""

    image: Any  # an original, not evaluated; None: none is chosen
    channel: str  # "alpha", "red", "green", "blue", or "gray", which is the luminance
    layer: str  # layer of texture coordinates; "": the rendered one
    image_from_uv: Affine
    extension: Extension
    smooth: bool
    alpha_used: bool  # whether the image node's alpha is used too
    # opacity at every texel value of `TEXEL_GRADES`; None: the texels' own values
    curve: np.ndarray | None = field(default=None, compare=False)

    @property
    def is_srgb(self) -> bool:
        """Whether its values are sRGB, which Cycles makes linear after it has interpolated."""
        return self.image is not None and has_srgb_texels(self.image, self.channel)

    def has_texels_in_unit_range(self) -> bool:
        """Return whether all texels are from 0 to 1, where curves are known."""
        if self.image is None or not self.image.is_float:
            return True
        values = channel_texels(self.image, self.channel, alpha_used=True)
        return bool(values.min() >= 0.0 and values.max() <= 1.0)


@dataclass(frozen=True, eq=False, slots=True)
class Cutter:
    """A material's alpha: a map, the layer of its coordinates ("": the rendered one), and their transform."""

    alpha: AlphaMap
    layer: str
    image_from_uv: Affine


def is_opaque(material: Any) -> bool:
    """Return whether nothing is visible through a material, whatever its textures."""
    for shader, around in surface_shaders_and_stacks(material):
        if shader.type == TRANSPARENT_SHADER:
            return False
        if shader.type == "BSDF_PRINCIPLED":
            alpha, _ = socket_source_and_stack(shader.inputs["Alpha"], around) or (shader.inputs["Alpha"], around)
            if alpha.is_output or alpha.default_value < 1.0:
                return False
    return True


def single_image_lookup(material: Any) -> Lookup | None:
    """Return the one lookup that the light of a material depends on; None if the light is constant."""
    found = _socket_lookups(material_output_node(material).inputs["Surface"], ())
    if len(found) > 1:
        raise NotUnderstoodError("two textures")
    return next(iter(found), None)


def _socket_lookups(socket: Any, stack: Stack) -> set[Lookup]:
    found = socket_source_and_stack(socket, stack)
    if found is None or not found[0].is_output:
        return set()
    output, stack = found
    node, kind = output.node, output.node.bl_idname.removeprefix("ShaderNode")
    if kind == "TexImage":
        return {_image_node_lookup(node, "alpha" if output.name == "Alpha" else "gray", stack)}
    if kind == "SeparateColor" and node.mode == "RGB":
        below = socket_source_and_stack(node.inputs[0], stack)
        if below is None or not below[0].is_output:
            return set()
        if below[0].node.bl_idname == "ShaderNodeTexImage" and below[0].name == "Color":
            return {_image_node_lookup(below[0].node, output.name.lower(), below[1])}
    if kind == "LightPath" and output.name.startswith("Is "):
        return set()
    odd = kind == "Mix" and (node.data_type, node.blend_type) not in (("RGBA", "MIX"), ("RGBA", "MULTIPLY"))
    if kind not in OF_GRAY or (odd and node.data_type != "FLOAT"):
        raise NotUnderstoodError(f"the node {node.name!r}")
    return {one for below in node.inputs if below.enabled for one in _socket_lookups(below, stack)}


def _image_node_lookup(node: Any, channel: str, stack: Stack) -> Lookup:
    image, own = node.image, node.texture_mapping
    if image is not None and image.source not in ("FILE", "GENERATED"):
        raise NotUnderstoodError(f"an image that is a {image.source.lower()}")
    mapped = (tuple(own.translation), tuple(own.rotation), tuple(own.scale)) != ((0, 0, 0), (0, 0, 0), (1, 1, 1))
    if node.projection != "FLAT" or node.extension == "MIRROR" or mapped:
        raise NotUnderstoodError(f"the projection of the node {node.name!r}")
    layer, image_from_uv = _uv_layer_and_transform(node.inputs["Vector"], stack)
    smooth, alpha_used = node.interpolation != "Closest", node.outputs["Alpha"].is_linked
    return Lookup(image, channel, layer, image_from_uv, Extension[node.extension], smooth, alpha_used)


def _uv_layer_and_transform(socket: Any, stack: Stack) -> tuple[str, Affine]:
    found = socket_source_and_stack(socket, stack)
    if found is None or not found[0].is_output:
        return "", IDENTITY_AFFINE
    output, stack = found
    node = output.node
    if node.bl_idname == "ShaderNodeTexCoord" and output.name == "UV" and not node.from_instancer:
        return "", IDENTITY_AFFINE
    if node.bl_idname == "ShaderNodeUVMap" and not node.from_instancer:
        return node.uv_map, IDENTITY_AFFINE
    if node.bl_idname == "ShaderNodeAttribute" and node.attribute_type == "GEOMETRY" and output.name == "Vector":
        return node.attribute_name, IDENTITY_AFFINE
    if node.bl_idname == "ShaderNodeMapping" and node.vector_type in ("POINT", "VECTOR", "TEXTURE"):
        layer, before = _uv_layer_and_transform(node.inputs["Vector"], stack)
        if not any(socket_source_and_stack(below, stack) for below in node.inputs if below.name != "Vector"):
            return layer, _compose_mapping(_mapping_matrix(node), before)
    raise NotUnderstoodError(f"the coordinates of the node {node.name!r}")


def _mapping_matrix(node: Any) -> Matrix:
    given = {socket.name: tuple(socket.default_value) for socket in node.inputs if socket.name != "Vector"}
    moved = Matrix.Translation(given["Location"]) if "Location" in given and node.vector_type != "VECTOR" else Matrix()
    turned = Euler(given["Rotation"], "XYZ").to_matrix().to_4x4()
    stretched = Matrix.Diagonal((*given["Scale"], 1.0))
    whole = moved @ turned @ stretched
    if node.vector_type != "TEXTURE":
        return whole
    if 0.0 in given["Scale"]:
        raise NotUnderstoodError(f"the scale of the node {node.name!r}")
    return whole.inverted()


def _compose_mapping(matrix: Matrix, before: Affine) -> Affine:
    both = np.array(matrix)[:2][:, [0, 1, 3]] @ np.array([*before, (0.0, 0.0, 1.0)])
    (a, b, c), (d, e, f) = both.tolist()
    return (a, b, c), (d, e, f)


def has_srgb_texels(image: Any, channel: str) -> bool:
    """Return whether texels of a channel are sRGB values, which Cycles makes linear after it has interpolated."""
    return channel != "alpha" and image.colorspace_settings.name == "sRGB"


def channel_texels(image: Any, channel: str, *, alpha_used: bool) -> np.ndarray:
    """Return the texels of an image's channel, in 255ths if the file has bytes, and in sRGB if `has_srgb_texels`."""
    if image.alpha_mode == "NONE" and channel == "alpha":
        return np.full((1, 1), 255, np.uint8)
    width, height = image.size
    share = min(1.0, (MAX_READ_PIXELS / (width * height)) ** 0.5)
    rgba = image_pixels(image, (int(width * share), int(height * share)))
    if channel == "alpha":
        return _quantize_like_image(rgba[..., 3], image)
    is_data = image.colorspace_settings.is_data or image.colorspace_settings.name in ("Non-Color", "Raw")
    color = rgba[..., :3]
    if not is_data and not alpha_used and image.alpha_mode in ("STRAIGHT", "PREMUL") and not image.is_float:
        color = color * rgba[..., 3:]
    curved = has_srgb_texels(image, channel)
    if curved and image.is_float:  # Blender's floats are linear
        color = srgb_from_linear(color)
    if channel != "gray":
        value = color[..., ("red", "green", "blue").index(channel)]
    elif (color == color[..., :1]).all():
        value = color[..., 0]
    else:
        linear = linear_from_srgb(color).astype(np.float32) if curved else color
        value = linear @ LUMINANCE_WEIGHTS.astype(np.float32)
        value = srgb_from_linear(value) if curved else value
    return _quantize_like_image(value, image)


def _quantize_like_image(values: np.ndarray, image: Any) -> np.ndarray:
    values = np.ascontiguousarray(values)
    return values if image.is_float else np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)
