"""Paint: nodes before a material's base color, controlled by properties of each object.

The nodes are inserted once, when a material is first painted. Their parameters are custom properties of the objects,
which Cycles reads at each hit. So vehicles that share a material can have different paints in one picture,
no shader is recompiled between pictures, and an object without the properties looks as in its file.
Runs inside Blender; needs bpy only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import bpy

from hulldown.reading.blender.api.add_nodes import add_node, maths
from hulldown.reading.blender.surfaces.nodes import trees
from hulldown.reading.blender.surfaces.shaders import BASE_COLORS
from hulldown.reading.blender.tidy_properties import UNPAINTED
from hulldown.rendering.blender.messages import PaintInput

BRIGHTEST = 4.0  # largest brightness of painted texture, in multiples of the mean
PREFIX = "hulldown paint "  # of the properties' names


class Paintable:
    """The materials of a loaded vehicle."""

    def __init__(self, objects: Iterable[bpy.types.Object], materials: Mapping[str, bpy.types.Material]) -> None:
        self._objects = list(objects)
        self._materials = dict(materials)
        for obj in self._objects:
            for slot in obj.material_slots:
                if slot.material is not None and slot.material.library is not None:
                    self._materials.setdefault(slot.material.name, slot.material)
        self._numbers: dict[str, int] = {}  # of those that have been painted

    def is_first(self, paints: Sequence[PaintInput]) -> bool:
        """Return whether one of these materials is painted for the first time."""
        return any(p.material in self._materials and p.material not in self._numbers for p in paints)

    def paint(self, objects: Iterable[Any], paints: Sequence[PaintInput]) -> None:
        """Paint a copy of the vehicle, replacing earlier paint."""
        on_all: dict[str, tuple[float, ...]] = {}
        on_parts: dict[str, tuple[float, ...]] = {}  # parts that stay unpainted by default
        for paint in paints:
            if paint.material in self._materials:
                properties = self._properties(paint)
                on_all |= properties
                on_parts |= properties if paint.everywhere else {}
        for obj in objects:
            color_inputs = on_parts if obj.get(UNPAINTED) else on_all
            before = {key: tuple(value) for key, value in obj.items() if key.startswith(PREFIX)}
            if before == color_inputs:
                continue
            for key in before:
                del obj[key]
            for key, value in color_inputs.items():
                obj[key] = value
            obj.update_tag()

    def _properties(self, paint: PaintInput) -> dict[str, tuple[float, ...]]:
        if paint.material not in self._numbers:
            self._numbers[paint.material] = len(self._numbers)
            material = self._own(paint.material)
            _insert(material.node_tree, self._numbers[paint.material], paint)
        color, shift = _names(self._numbers[paint.material])
        color_inputs: dict[str, tuple[float, ...]] = {}
        if paint.color is not None:
            color_inputs[color] = (*paint.color, 1.0)
        if (paint.hue, paint.saturation, paint.value) != (0.0, 1.0, 1.0):
            color_inputs[shift] = (0.5 + paint.hue, paint.saturation, paint.value, 1.0)
        return color_inputs

    def _own(self, name: str) -> Any:
        """Return a local copy of a material, since linked ones can't be changed."""
        material = self._materials[name]
        if material.library is None:
            return material
        copy = self._materials[name] = material.copy()
        for obj in self._objects:
            for slot in obj.material_slots:
                if slot.material == material:
                    slot.material = copy
        return copy


def _names(number: int) -> tuple[str, str]:
    """Return names of the properties with a material's color, and with its changes of hue, saturation, and value."""
    return f"{PREFIX}{number} color", f"{PREFIX}{number} shift"


def _insert(tree: Any, number: int, paint: PaintInput) -> None:
    """Insert nodes before all base colors of a tree and of copies of its groups."""
    for node in list(tree.nodes):
        if node.type == "GROUP" and node.node_tree is not None:
            if any(inner.type in BASE_COLORS for below in trees(node.node_tree) for inner in below.nodes):
                node.node_tree = node.node_tree.copy()
                _insert(node.node_tree, number, paint)
        elif node.type in BASE_COLORS:
            socket = node.inputs[BASE_COLORS[node.type]]
            tree.links.new(_painted(tree, socket, number, paint), socket)


def _painted(tree: Any, socket: Any, number: int, paint: PaintInput) -> Any:
    """Return an output with a socket's painted color."""
    color, shift = (
        add_node(tree, "Attribute", attribute_type="OBJECT", attribute_name=name) for name in _names(number)
    )
    if socket.is_linked:
        base = socket.links[0].from_socket
        gray = add_node(tree, "RGBToBW", {0: base}).outputs[0]
        bounded = maths(tree, "MINIMUM", maths(tree, "MULTIPLY", gray, 1.0 / max(paint.mean, 1e-4)), BRIGHTEST)
        scaled = {0: color.outputs["Color"], "Scale": bounded}
        fresh = add_node(tree, "VectorMath", scaled, operation="SCALE").outputs[0]
    else:
        rgb = tree.nodes.new("ShaderNodeRGB")
        rgb.outputs[0].default_value = socket.default_value
        base, fresh = rgb.outputs[0], color.outputs["Color"]
    colored = _mix(tree, color.outputs["Alpha"], base, fresh)
    hue, saturation, value = add_node(tree, "SeparateXYZ", {0: shift.outputs["Vector"]}).outputs
    turned = add_node(tree, "HueSaturation", {"Hue": hue, "Saturation": saturation, "Value": value, "Color": colored})
    return _mix(tree, shift.outputs["Alpha"], colored, turned.outputs[0])


def _mix(tree: Any, share: Any, before: Any, after: Any) -> Any:
    """Mix two colors, limited to 1 so that no surface adds light."""
    bounded = add_node(tree, "VectorMath", {0: after, 1: (1.0, 1.0, 1.0)}, operation="MINIMUM").outputs[0]
    return add_node(tree, "Mix", {0: share, 6: before, 7: bounded}, data_type="RGBA").outputs[2]
