"""Weather in every material of a scene, with shares of ground and vehicles; none is left in a row without."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from typing import Any

import bpy
import numpy as np

from hulldown.blender.nodes import material_output_node, tree_and_nested_trees
from hulldown.blender.opacity_nodes import OPACITY_SOCKET, add_opacity_socket
from hulldown.blender.shaders import is_clear_material
from hulldown.reading.pieces.naming import NOT_WATER, WATER_BODY_WORDS, WATER_WORDS, first_matching_pattern
from hulldown.render.blender import covers
from hulldown.weather.kinds import WEATHER_KINDS

NODE_LABEL = "hulldown weather"  # on inserted nodes
MATERIAL_PREFIX = "hulldown"  # begins the names of the stage's own materials
SCENERY, VEHICLES = "scenery", "vehicles"
UNCOVERED_SHADERS = ("BSDF_GLOSSY", "BSDF_METALLIC", "BSDF_GLASS", "BSDF_REFRACTION", "BSDF_TRANSPARENT", "EMISSION")

# By the name of a cover, the node groups that make it, of a name and for vehicles or not.
COVER_BUILDERS: Mapping[str, Callable[[str, bool], list[Any]]] = {
    "water": lambda name, vehicles: [covers.wetting_group(name, film=vehicles), covers.soaking_group(f"{name}, matt")],
    "snow": lambda name, vehicles: [covers.snow_group(name)],
    "dust": lambda name, vehicles: [covers.dust_group(name, climbs=vehicles)],
}
NodeTreeShape = tuple[tuple[str, int], ...]  # names of a material's node tree and the groups in it, with their nodes


class Surfaces:
    """Water, snow, or dust on a stage's surfaces."""

    def __init__(self) -> None:
        self._kind = ""
        self._groups: dict[tuple[str, str], list[Any]] = {}  # by kind and by what it covers, made when first needed
        self._dressed: dict[int, NodeTreeShape] = {}  # by session id of a material
        self.left: list[str] = []  # materials without a shader that rain can change

    def set(self, kind: str, ground: float, vehicle: float, vehicles: Iterable[Any]) -> None:
        """Cover scenery and vehicles, each by shares from 0 to 1 of water in pores, snow on level ground, or dust."""
        kind = kind if WEATHER_KINDS[kind].surfaces and max(ground, vehicle) > 0 else ""
        if kind != self._kind or any(self._dressed.get(m.session_uid, s) != s for m, s in _materials_and_tree_shapes()):
            self.clear()
            self._kind = kind
        if not kind:
            return
        self._cover_new_materials({slot.material for obj in vehicles for slot in obj.material_slots})
        for wearer, share in ((SCENERY, ground), (VEHICLES, vehicle)):
            for group in self._cover_groups(wearer):
                value = group.nodes[covers.SHARE_ATTRIBUTE].outputs[0]
                if value.default_value != np.float32(share):  # setting it would have Cycles compile all shaders anew
                    value.default_value = share

    def clear(self) -> None:
        """Remove all inserted nodes."""
        if self._kind:
            for material, _ in _materials_and_tree_shapes():
                _remove_weather_nodes(material.node_tree)
            for tree in bpy.data.node_groups:
                _remove_weather_nodes(tree)
        self._kind = ""
        self._dressed.clear()
        self.left.clear()

    def _cover_new_materials(self, worn: Set[Any]) -> None:
        known = len(self.left)
        if new := [material for material, _ in _materials_and_tree_shapes() if material.session_uid not in self._dressed]:
            for material in new:
                self._cover_material(material, VEHICLES if material in worn else SCENERY)
            self._dressed = {material.session_uid: shape for material, shape in _materials_and_tree_shapes()}
        if self.left[known:]:  # in the log
            print(f"rain leaves materials as they are, whose shaders are not understood: {self.left[known:]}")

    def _cover_groups(self, wearer: str) -> list[Any]:
        key = self._kind, wearer
        if key not in self._groups:
            name = f"{MATERIAL_PREFIX} {self._kind} on {wearer}"
            self._groups[key] = COVER_BUILDERS[WEATHER_KINDS[self._kind].surfaces](name, wearer == VEHICLES)
        return self._groups[key]

    def _cover_material(self, material: Any, wearer: str) -> None:
        groups, cover = self._cover_groups(wearer), WEATHER_KINDS[self._kind].surfaces
        if cover == "water":
            wetted = [_wet_and_count_shaders(tree, *groups) for tree in tree_and_nested_trees(material.node_tree)]
            if not any(wetted):
                self.left.append(material.name)
        elif cover != "snow" or wearer == VEHICLES or not _is_water_material(material):
            _cover_material_output(material, groups[0])


def _materials_and_tree_shapes() -> Iterator[tuple[Any, NodeTreeShape]]:
    for material in list(bpy.data.materials):
        if material.node_tree and not material.is_grease_pencil and not material.name.startswith(MATERIAL_PREFIX):
            yield material, tuple((tree.name, len(tree.nodes)) for tree in tree_and_nested_trees(material.node_tree))


def _is_water_material(material: Any) -> bool:
    wet = first_matching_pattern(material.name, (*WATER_WORDS, *WATER_BODY_WORDS)) and not first_matching_pattern(
        material.name, NOT_WATER
    )
    return bool(wet) or is_clear_material(material)


def _wet_and_count_shaders(tree: Any, principled: Any, matt: Any) -> int:
    understood = 0
    for node in list(tree.nodes):
        if node.type in ("BSDF_PRINCIPLED", "BSDF_DIFFUSE"):
            group = principled if node.type == "BSDF_PRINCIPLED" else matt
            outputs = [item.name for item in group.interface.items_tree if item.in_out == "OUTPUT"]
            if not any(link.from_node.label == NODE_LABEL for link in node.inputs[outputs[0]].links):
                _insert_group_before_shader(tree, node, group, outputs)
        understood += node.type in ("BSDF_PRINCIPLED", "BSDF_DIFFUSE", *UNCOVERED_SHADERS)
    return understood


def _insert_group_before_shader(tree: Any, shader: Any, group: Any, outputs: Sequence[str]) -> None:
    node = _add_group_node(tree, group)
    for socket in node.inputs:
        shader_input = shader.inputs[socket.name]
        if shader_input.is_linked:
            tree.links.new(shader_input.links[0].from_socket, socket)
        else:
            socket.default_value = shader_input.default_value
    for name in outputs:
        tree.links.new(node.outputs[name], shader.inputs[name])


def _cover_material_output(material: Any, group: Any) -> None:
    tree, output = material.node_tree, material_output_node(material)
    if output is None or not output.inputs["Surface"].is_linked:
        return
    before = [(inner, {node.as_pointer() for node in inner.nodes}) for inner in tree_and_nested_trees(tree)]
    opacity = add_opacity_socket(material)
    for inner, nodes in before:
        for node in inner.nodes:
            if node.as_pointer() not in nodes:
                node.label = NODE_LABEL
    node, surface = _add_group_node(tree, group), output.inputs["Surface"]
    tree.links.new(surface.links[0].from_socket, node.inputs["Surface"])
    tree.links.new(node.outputs["Surface"], surface)
    if isinstance(opacity, float):
        node.inputs["Opacity"].default_value = opacity
    else:
        tree.links.new(opacity, node.inputs["Opacity"])


def _add_group_node(tree: Any, group: Any) -> Any:
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree, node.label = group, NODE_LABEL
    return node


def _remove_weather_nodes(tree: Any) -> None:
    marked = [node for node in tree.nodes if node.label == NODE_LABEL]
    for node in marked:
        for socket in node.outputs if node.bl_idname == "ShaderNodeGroup" else ():
            given = node.inputs[socket.name]
            for link in list(socket.links):
                if given.is_linked:
                    tree.links.new(given.links[0].from_socket, link.to_socket)
    for node in marked:
        tree.nodes.remove(node)
    for item in [item for item in tree.interface.items_tree if item.name.startswith(OPACITY_SOCKET)]:
        tree.interface.remove(item)
