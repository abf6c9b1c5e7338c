"""Opacity of a material as a curve over the values of one image lookup, from the node tree.

Cycles lets a ray through what Transparent BSDFs leave of a surface. All other shaders stop it, whatever they do with
light. So the opacity of a surface is 1 for those and 0 for Transparent, Principled has its own, and mixes mix it.
A lookup takes 0.2 ms of CPU time and keeps every texel where a texture repeats; baking 1024 x 1024 takes 420 ms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from mathutils import Euler, Matrix

from hulldown.geometry.alpha import GRADES, AlphaMap
from hulldown.geometry.color import LUMINANCE, linear_from_srgb
from hulldown.reading.blender.surfaces.nodes import Stack, material_output, source
from hulldown.reading.blender.surfaces.texels import is_curved, texels

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
Affine = tuple[tuple[float, float, float], tuple[float, float, float]]


class NotUnderstoodError(Exception):
    """A node tree that is more than one lookup."""


@dataclass(frozen=True, slots=True)
class Lookup:
    """An image, a channel, and a layer of coordinates; an empty name is the rendered layer.

    `bounded` tells whether all texels are from 0 to 1, where curves are known.
    """

    node: Any
    channel: str
    layer: str
    image_from_uv: Affine
    bounded: bool


@dataclass(frozen=True, eq=False, slots=True)
class Cutter:
    """A material's alpha: a map, the layer of its coordinates ("": the rendered one), and their transform."""

    alpha: AlphaMap
    layer: str
    image_from_uv: Affine


@dataclass(frozen=True, eq=False, slots=True)
class Value:
    """A number at every texel value of `GRADES`, or, without a lookup, one number."""

    lookup: Lookup | None
    curve: np.ndarray


def constant(number: float) -> Value:
    """The same value everywhere."""
    return Value(None, np.array(number, dtype=np.float32))


def opacity_of(material: Any) -> Value:
    """The opacity of a material, from 0 to 1.

    Raises
    ------
    NotUnderstoodError
        If it isn't a monotone function of one lookup.
    """
    output = material_output(material)
    if not output or not output.inputs["Surface"].is_linked:
        return constant(1.0)
    value = _clamped(_shader(output.inputs["Surface"], ()))
    if value.lookup and not ((np.diff(value.curve) >= 0.0).all() or (np.diff(value.curve) <= 0.0).all()):
        raise NotUnderstoodError("a texture's values in both directions")
    return value


def _of(function: Callable[..., np.ndarray], *values: Value) -> Value:
    """A function of values."""
    lookups = {value.lookup for value in values if value.lookup}
    if len(lookups) > 1:
        raise NotUnderstoodError("two textures")
    curve = np.asarray(function(*(value.curve for value in values)), dtype=np.float32)
    if not all(lookup.bounded for lookup in lookups) and not np.array_equal(curve, GRADES):
        raise NotUnderstoodError("a texture's values beyond 1")
    if (curve == curve.flat[0]).all():
        return constant(float(curve.flat[0]))
    return Value(lookups.pop(), curve)


def _clamped(value: Value) -> Value:
    return _of(lambda x: np.clip(x, 0.0, 1.0), value)


def _shader(socket: Any, stack: Stack) -> Value:
    found = source(socket, stack)
    if found is None or not found[0].is_output:
        return constant(1.0)
    node, stack = found[0].node, found[1]
    kind = node.bl_idname
    if kind == "ShaderNodeBsdfTransparent":
        return _of(lambda color: 1.0 - color, _value(node.inputs["Color"], stack))
    if kind == "ShaderNodeBsdfPrincipled":
        return _clamped(_value(node.inputs["Alpha"], stack))
    if kind == "ShaderNodeMixShader":
        share = _clamped(_value(node.inputs[0], stack))
        return _mixed(share, lambda: _shader(node.inputs[1], stack), lambda: _shader(node.inputs[2], stack))
    if kind == "ShaderNodeAddShader":
        return _clamped(_of(lambda a, b: a + b - 1.0, *(_shader(below, stack) for below in node.inputs)))
    return constant(1.0)


def _value(socket: Any, stack: Stack) -> Value:
    """Value of a number socket, or of a color socket by its luminance."""
    found = source(socket, stack)
    if found is None:
        return constant(_own(socket))
    output, stack = found
    if not output.is_output:
        return constant(_own(output))
    node = output.node
    read = _READ.get(node.bl_idname)
    if read is None:
        raise NotUnderstoodError(f"the node {node.name!r}")
    return read(node, output, stack)


def _own(socket: Any) -> float:
    value: Any = getattr(socket, "default_value", 0.0)
    return float(np.dot(LUMINANCE, value[:3])) if hasattr(value, "__len__") else float(value)


def _mixed(share: Value, first: Callable[[], Value], second: Callable[[], Value]) -> Value:
    """(1 - share) first + share second; a side without a share isn't evaluated."""
    if share.lookup is None and share.curve in (0.0, 1.0):
        return second() if share.curve else first()
    return _of(lambda s, a, b: a + s * (b - a), share, first(), second())


def _divided(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The quotient; 0 where there is none, as in Cycles."""
    return np.where(b == 0.0, 0.0, a / np.where(b == 0.0, 1.0, b))


_MATH: dict[str, Callable[..., np.ndarray]] = {
    "ADD": np.add,
    "SUBTRACT": np.subtract,
    "MULTIPLY": np.multiply,
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "DIVIDE": _divided,
    "GREATER_THAN": np.greater,
    "LESS_THAN": np.less,
    "MINIMUM": np.minimum,
    "MAXIMUM": np.maximum,
    "ROUND": lambda a: np.floor(a + np.float32(0.5)),
    "FLOOR": np.floor,
    "CEIL": np.ceil,
    "POWER": lambda a, b: np.maximum(a, 0.0) ** b,
}


def _math(node: Any, _: Any, stack: Stack) -> Value:
    if node.operation not in _MATH:
        raise NotUnderstoodError(f"the node {node.name!r}")
    value = _of(_MATH[node.operation], *(_value(socket, stack) for socket in node.inputs if socket.enabled))
    return _clamped(value) if node.use_clamp else value


def _mix(node: Any, _: Any, stack: Stack) -> Value:
    colors = node.data_type == "RGBA"
    if node.data_type not in ("FLOAT", "RGBA") or (colors and node.blend_type not in ("MIX", "MULTIPLY")):
        raise NotUnderstoodError(f"the node {node.name!r}")
    share, a, b = [socket for socket in node.inputs if socket.enabled]
    weight = _value(share, stack)
    if node.clamp_factor:
        weight = _clamped(weight)
    if colors and node.blend_type == "MULTIPLY":
        first = _value(a, stack)
        value = _mixed(weight, lambda: first, lambda: _of(np.multiply, first, _value(b, stack)))
    else:
        value = _mixed(weight, lambda: _value(a, stack), lambda: _value(b, stack))
    return _clamped(value) if colors and node.clamp_result else value


def _map_range(node: Any, _: Any, stack: Stack) -> Value:
    if node.data_type != "FLOAT" or node.interpolation_type != "LINEAR":
        raise NotUnderstoodError(f"the node {node.name!r}")
    value, low, high, *to = (_value(socket, stack) for socket in node.inputs if socket.enabled)
    share = _of(lambda x, a, b: _divided(x - a, b - a), value, low, high)
    return _of(lambda s, c, d: c + s * (d - c), _clamped(share) if node.clamp else share, *to)


def _clamp(node: Any, _: Any, stack: Stack) -> Value:
    if node.clamp_type != "MINMAX":
        raise NotUnderstoodError(f"the node {node.name!r}")
    return _of(np.clip, *(_value(socket, stack) for socket in node.inputs))


def _invert(node: Any, _: Any, stack: Stack) -> Value:
    color = _value(node.inputs["Color"], stack)
    return _mixed(_value(node.inputs["Fac"], stack), lambda: color, lambda: _of(lambda c: 1.0 - c, color))


def _channel(node: Any, output: Any, stack: Stack) -> Value:
    """One of red, green and blue, of a texture."""
    found = source(node.inputs[0], stack)
    mode = getattr(node, "mode", "RGB")
    if found is None or not found[0].is_output:
        color = (found[0] if found else node.inputs[0]).default_value
        return constant(color[list(node.outputs).index(output)])
    below, around = found
    if mode != "RGB" or below.node.bl_idname != "ShaderNodeTexImage" or below.name != "Color":
        raise NotUnderstoodError(f"the node {node.name!r}")
    return _lookup(below.node, ("red", "green", "blue")[list(node.outputs).index(output)], around)


def _image(node: Any, output: Any, stack: Stack) -> Value:
    return _lookup(node, "alpha" if output.name == "Alpha" else "gray", stack)


def _lookup(node: Any, channel: str, stack: Stack) -> Value:
    image = node.image
    if image is not None and image.source not in ("FILE", "GENERATED"):
        raise NotUnderstoodError(f"an image that is a {image.source.lower()}")
    if node.projection != "FLAT" or node.extension == "MIRROR" or _is_mapped(node):
        raise NotUnderstoodError(f"the projection of the node {node.name!r}")
    curved = image is not None and is_curved(image, channel)
    curve = linear_from_srgb(GRADES).astype(np.float32) if curved else GRADES
    layer, image_from_uv = _coordinates(node.inputs["Vector"], stack)
    return Value(Lookup(node, channel, layer, image_from_uv, _is_bounded(image, channel)), curve)


def _is_bounded(image: Any, channel: str) -> bool:
    if image is None or not image.is_float:
        return True
    values = texels(image.original, channel, alpha_used=True)
    return bool(values.min() >= 0.0 and values.max() <= 1.0)


def _is_mapped(node: Any) -> bool:
    own = node.texture_mapping
    return (tuple(own.translation), tuple(own.rotation), tuple(own.scale)) != ((0, 0, 0), (0, 0, 0), (1, 1, 1))


def _coordinates(socket: Any, stack: Stack) -> tuple[str, Affine]:
    """The layer of texture coordinates, and their transform."""
    found = source(socket, stack)
    if found is None or not found[0].is_output:
        return "", IDENTITY
    output, stack = found
    node = output.node
    if node.bl_idname == "ShaderNodeTexCoord" and output.name == "UV" and not node.from_instancer:
        return "", IDENTITY
    if node.bl_idname == "ShaderNodeUVMap" and not node.from_instancer:
        return node.uv_map, IDENTITY
    if node.bl_idname == "ShaderNodeAttribute" and node.attribute_type == "GEOMETRY" and output.name == "Vector":
        return node.attribute_name, IDENTITY
    if node.bl_idname == "ShaderNodeMapping" and node.vector_type in ("POINT", "VECTOR", "TEXTURE"):
        layer, before = _coordinates(node.inputs["Vector"], stack)
        if not any(source(below, stack) for below in node.inputs if below.name != "Vector"):
            return layer, _after(_mapping(node), before)
    raise NotUnderstoodError(f"the coordinates of the node {node.name!r}")


def _mapping(node: Any) -> Matrix:
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


def _after(matrix: Matrix, before: Affine) -> Affine:
    both = np.array(matrix)[:2][:, [0, 1, 3]] @ np.array([*before, (0.0, 0.0, 1.0)])
    (a, b, c), (d, e, f) = both.tolist()
    return (a, b, c), (d, e, f)


def _light_path(node: Any, output: Any, _: Stack) -> Value:
    if not output.name.startswith("Is "):
        raise NotUnderstoodError(f"the node {node.name!r}")
    return constant(output.name == "Is Camera Ray")


_READ: dict[str, Callable[[Any, Any, Stack], Value]] = {
    "ShaderNodeTexImage": _image,
    "ShaderNodeMath": _math,
    "ShaderNodeMix": _mix,
    "ShaderNodeMapRange": _map_range,
    "ShaderNodeClamp": _clamp,
    "ShaderNodeInvert": _invert,
    "ShaderNodeSeparateColor": _channel,
    "ShaderNodeRGBToBW": lambda node, _, stack: _value(node.inputs["Color"], stack),
    "ShaderNodeValue": lambda _, output, __: constant(_own(output)),
    "ShaderNodeRGB": lambda _, output, __: constant(_own(output)),
    "ShaderNodeLightPath": _light_path,
}
