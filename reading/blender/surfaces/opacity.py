"""Opacity of a material as one image lookup and steps on its value, from the node tree.

Cycles lets a ray through what Transparent BSDFs leave of a surface. All other shaders stop it, whatever they do with
light. So the opacity of a surface is 1 for those and 0 for Transparent, Principled has its own, and mixes mix it.
A lookup takes 0.2 ms of CPU time and keeps every texel where a texture repeats; baking 1024 x 1024 takes 420 ms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mathutils import Euler, Matrix

from hulldown.geometry.alpha import Step, stepped
from hulldown.geometry.color import LUMINANCE
from hulldown.reading.blender.surfaces.nodes import Stack, material_output, source

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
Affine = tuple[tuple[float, float, float], tuple[float, float, float]]


class NotUnderstoodError(Exception):
    """A node tree that is more than one lookup."""


@dataclass(frozen=True, slots=True)
class Lookup:
    """An image, a channel, and a layer of coordinates; an empty name is the rendered layer."""

    node: Any
    channel: str
    layer: str
    image_from_uv: Affine


@dataclass(frozen=True, slots=True)
class Value:
    """Steps on a lookup's value, or a constant."""

    lookup: Lookup | None
    steps: tuple[tuple[Step, float], ...] = ()
    constant: float = 0.0

    def then(self, step: Step, number: float = 0.0) -> Value:
        """The value with a step more."""
        if self.lookup is not None:
            return replace(self, steps=(*self.steps, (step, float(number))))
        texel = np.full((1, 1), self.constant, dtype=np.float32)
        return constant(float(stepped(texel, [(step, number)])[0, 0]))

    def clamped(self) -> Value:
        """Within 0 and 1."""
        return self.then(Step.MAXIMUM, 0.0).then(Step.MINIMUM, 1.0) if self.steps or self.lookup is None else self


def constant(number: float) -> Value:
    """The same value everywhere."""
    return Value(None, (), float(number))


def opacity_of(material: Any) -> Value:
    """The opacity of a material.

    Raises
    ------
    NotUnderstoodError
        If it is more than steps on one lookup.
    """
    output = material_output(material)
    if not output or not output.inputs["Surface"].is_linked:
        return constant(1.0)
    return _shader(output.inputs["Surface"], ())


def _shader(socket: Any, stack: Stack) -> Value:
    found = source(socket, stack)
    if found is None or not found[0].is_output:
        return constant(1.0)
    node, stack = found[0].node, found[1]
    kind = node.bl_idname
    if kind == "ShaderNodeBsdfTransparent":
        return _minus(constant(1.0), _value(node.inputs["Color"], stack))
    if kind == "ShaderNodeBsdfPrincipled":
        return _value(node.inputs["Alpha"], stack).clamped()
    if kind == "ShaderNodeMixShader":
        share = _value(node.inputs[0], stack).clamped()
        return _mixed(share, lambda: _shader(node.inputs[1], stack), lambda: _shader(node.inputs[2], stack))
    if kind == "ShaderNodeAddShader":
        both = [_shader(below, stack) for below in node.inputs]
        return _plus(_plus(both[0], both[1]), constant(-1.0)).clamped()
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


def _plus(a: Value, b: Value) -> Value:
    if b.lookup is None:
        return a.then(Step.ADD, b.constant)
    if a.lookup is None:
        return b.then(Step.ADD, a.constant)
    raise NotUnderstoodError("two textures")


def _minus(a: Value, b: Value) -> Value:
    return _plus(a, b.then(Step.MULTIPLY, -1.0))


def _times(a: Value, b: Value) -> Value:
    if b.lookup is None:
        return a.then(Step.MULTIPLY, b.constant)
    if a.lookup is None:
        return b.then(Step.MULTIPLY, a.constant)
    raise NotUnderstoodError("two textures")


def _mixed(share: Value, first: Callable[[], Value], second: Callable[[], Value]) -> Value:
    """(1 - share) first + share second; a side without a share isn't evaluated."""
    if share.lookup is None and share.constant in (0.0, 1.0):
        return second() if share.constant else first()
    a, b = first(), second()
    if a == b:
        return a
    if a.lookup is None and b.lookup is None:
        if (a.constant, b.constant) == (0.0, 1.0):
            return share
        return _plus(_times(share, constant(b.constant - a.constant)), a)
    return _plus(_times(_minus(constant(1.0), share), a), _times(share, b))


def _math(node: Any, _: Any, stack: Stack) -> Value:
    inputs = [_value(socket, stack) for socket in node.inputs if socket.enabled]
    a, b = inputs[0], inputs[1] if len(inputs) > 1 else constant(0.0)
    fixed = b.constant if b.lookup is None else None
    operation = node.operation
    if operation == "ADD":
        value = _plus(a, b)
    elif operation == "SUBTRACT":
        value = _minus(a, b)
    elif operation == "MULTIPLY":
        value = _times(a, b)
    elif operation == "MULTIPLY_ADD":
        value = _plus(_times(a, b), inputs[2])
    elif operation == "DIVIDE" and fixed:
        value = a.then(Step.MULTIPLY, 1.0 / fixed)
    elif operation == "ROUND":
        value = a.then(Step.ROUND)
    elif operation == "CEIL":
        value = a.then(Step.MULTIPLY, -1.0).then(Step.FLOOR).then(Step.MULTIPLY, -1.0)
    elif operation == "FLOOR":
        value = a.then(Step.FLOOR)
    elif operation in _COMPARED and fixed is not None:
        value = a.then(_COMPARED[operation], fixed)
    elif operation in _TURNED and a.lookup is None:
        value = b.then(_TURNED[operation], a.constant)
    else:
        raise NotUnderstoodError(f"the node {node.name!r}")
    return value.clamped() if node.use_clamp else value


_COMPARED = {
    "GREATER_THAN": Step.GREATER, "LESS_THAN": Step.LESS, "MINIMUM": Step.MINIMUM, "MAXIMUM": Step.MAXIMUM,
    "POWER": Step.POWER,
}  # fmt: skip
_TURNED = {
    "GREATER_THAN": Step.LESS, "LESS_THAN": Step.GREATER, "MINIMUM": Step.MINIMUM, "MAXIMUM": Step.MAXIMUM,
}  # fmt: skip


def _mix(node: Any, _: Any, stack: Stack) -> Value:
    colors = node.data_type == "RGBA"
    if node.data_type not in ("FLOAT", "RGBA") or (colors and node.blend_type not in ("MIX", "MULTIPLY")):
        raise NotUnderstoodError(f"the node {node.name!r}")
    share, a, b = [socket for socket in node.inputs if socket.enabled]
    weight = _value(share, stack)
    if node.clamp_factor:
        weight = weight.clamped()
    if colors and node.blend_type == "MULTIPLY":
        first = _value(a, stack)
        value = _mixed(weight, lambda: first, lambda: _times(first, _value(b, stack)))
    else:
        value = _mixed(weight, lambda: _value(a, stack), lambda: _value(b, stack))
    return value.clamped() if colors and node.clamp_result else value


def _map_range(node: Any, _: Any, stack: Stack) -> Value:
    given = {socket.name: socket for socket in node.inputs if socket.enabled}
    ends = [_value(given[name], stack) for name in ("From Min", "From Max", "To Min", "To Max") if name in given]
    if node.data_type != "FLOAT" or node.interpolation_type != "LINEAR" or any(end.lookup for end in ends):
        raise NotUnderstoodError(f"the node {node.name!r}")
    a, b, c, d = (end.constant for end in ends)
    if a == b:
        return constant(c)
    share = _times(_plus(_value(given["Value"], stack), constant(-a)), constant(1.0 / (b - a)))
    if node.clamp:
        share = share.then(Step.MAXIMUM, 0.0).then(Step.MINIMUM, 1.0)
    return _plus(_times(share, constant(d - c)), constant(c))


def _clamp(node: Any, _: Any, stack: Stack) -> Value:
    value, low, high = (_value(socket, stack) for socket in node.inputs)
    if low.lookup or high.lookup or node.clamp_type != "MINMAX":
        raise NotUnderstoodError(f"the node {node.name!r}")
    return value.then(Step.MAXIMUM, low.constant).then(Step.MINIMUM, high.constant)


def _invert(node: Any, _: Any, stack: Stack) -> Value:
    color = _value(node.inputs["Color"], stack)
    return _mixed(_value(node.inputs["Fac"], stack), lambda: color, lambda: _minus(constant(1.0), color))


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
    return Value(_lookup(below.node, ("red", "green", "blue")[list(node.outputs).index(output)], around))


def _image(node: Any, output: Any, stack: Stack) -> Value:
    return Value(_lookup(node, "alpha" if output.name == "Alpha" else "gray", stack))


def _lookup(node: Any, channel: str, stack: Stack) -> Lookup:
    image = node.image
    if image is not None and image.source not in ("FILE", "GENERATED"):
        raise NotUnderstoodError(f"an image that is a {image.source.lower()}")
    if node.projection != "FLAT" or node.extension == "MIRROR" or _is_mapped(node):
        raise NotUnderstoodError(f"the projection of the node {node.name!r}")
    return Lookup(node, channel, *_coordinates(node.inputs["Vector"], stack))


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
