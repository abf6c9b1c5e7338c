"""Paint: a node before a base color that reads a property of each object, so that no shader is recompiled."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import bpy

from hulldown.blender.add_nodes import add_math_output, add_node
from hulldown.blender.nodes import tree_and_nested_trees
from hulldown.blender.shaders import BASE_COLOR_INPUTS

MID_GRAY = 0.18  # linear; a painted surface of it has the paint's own, black half of it, white 1.35 times
PROPERTY_PREFIX = "hulldown paint "  # begins the properties' names
PaintColors = Mapping[str, tuple[float, float, float]]  # linear, by the material's name


class PaintedMaterials:
    """The materials of a loaded vehicle."""

    def __init__(self, objects: Iterable[bpy.types.Object], materials: Mapping[str, bpy.types.Material]) -> None:
        self._objects = list(objects)
        self._materials = dict(materials)
        for obj in self._objects:
            for slot in obj.material_slots:
                if slot.material is not None and slot.material.library is not None:
                    self._materials.setdefault(slot.material.name, slot.material)
        self._properties: dict[str, str] = {}  # of painted materials, by name

    def needs_paint_nodes(self, colors: PaintColors) -> bool:
        """Return whether one of these materials is painted for the first time."""
        return bool((colors.keys() & self._materials.keys()) - self._properties.keys())

    def paint(self, objects: Iterable[Any], colors: PaintColors) -> None:
        """Paint a copy of the vehicle, replacing earlier paint."""
        named = {name: color for name, color in colors.items() if name in self._materials}
        wanted = {self._ensure_paint_property(name): (*color, 1.0) for name, color in named.items()}
        for obj in objects:
            before = {key: tuple(value) for key, value in obj.items() if key.startswith(PROPERTY_PREFIX)}
            if before == wanted:
                continue
            for key in before:
                del obj[key]
            for key, value in wanted.items():
                obj[key] = value
            obj.update_tag()

    def _ensure_paint_property(self, material: str) -> str:
        if material not in self._properties:
            self._properties[material] = f"{PROPERTY_PREFIX}{len(self._properties)}"
            _insert_paint_nodes(self._make_material_local(material).node_tree, self._properties[material])
        return self._properties[material]

    def _make_material_local(self, name: str) -> Any:
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


def _insert_paint_nodes(tree: Any, name: str) -> None:
    for node in list(tree.nodes):
        if node.type == "GROUP" and node.node_tree is not None:
            if any(inner.type in BASE_COLOR_INPUTS for below in tree_and_nested_trees(node.node_tree) for inner in below.nodes):
                node.node_tree = node.node_tree.copy()
                _insert_paint_nodes(node.node_tree, name)
        elif node.type in BASE_COLOR_INPUTS:
            socket = node.inputs[BASE_COLOR_INPUTS[node.type]]
            own = socket.links[0].from_socket if socket.is_linked else tuple(socket.default_value)
            color = add_node(tree, "Attribute", attribute_type="OBJECT", attribute_name=name).outputs
            inputs = {0: color["Alpha"], 6: own, 7: _shaded_paint_socket(tree, color["Color"], own)}
            tree.links.new(add_node(tree, "Mix", inputs, data_type="RGBA").outputs[2], socket)


def _shaded_paint_socket(tree: Any, color: Any, own: Any) -> Any:
    """Return the color, at most 1, brighter or darker than the paint where the material is, so that dirt remains."""
    gray = add_node(tree, "RGBToBW", {0: own}).outputs[0]
    factor = add_math_output(
        tree, "ADD", 0.5, add_math_output(tree, "DIVIDE", gray, add_math_output(tree, "ADD", gray, MID_GRAY))
    )
    scaled = add_node(tree, "VectorMath", {0: color, "Scale": factor}, operation="SCALE").outputs[0]
    return add_node(tree, "VectorMath", {0: scaled, 1: (1.0, 1.0, 1.0)}, operation="MINIMUM").outputs[0]
