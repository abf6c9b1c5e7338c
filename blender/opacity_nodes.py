"""The opacity of a material as a socket of its node tree: what `reading.blender.surfaces.opacity` reads from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.blender.add_nodes import add_math_output, add_node, feed_input
from hulldown.blender.nodes import group_output_node, linked_output, material_output_node

OPACITY_SOCKET = "hulldown opacity"


def add_opacity_socket(material: Any) -> Any:
    """Return a new output socket with a material's opacity, or a number if it's constant; its look is the same."""
    output = material_output_node(material)
    return _add_shader_opacity(material.node_tree, output.inputs["Surface"], {}) if output else 1.0


def _add_shader_opacity(tree: Any, socket: Any, made: dict[Any, Any]) -> Any:
    given = linked_output(socket)
    if given is None:
        return 1.0
    key = (tree.as_pointer(), given.as_pointer())
    if key not in made:
        made[key] = _add_output_opacity(tree, given.node, given, made)
    return made[key]


def _add_output_opacity(tree: Any, node: Any, given: Any, made: dict[Any, Any]) -> Any:
    kind = node.bl_idname
    if node.mute:
        inner = next((link.from_socket for link in node.internal_links if link.to_socket == given), None)
        return 1.0 if inner is None else _add_shader_opacity(tree, inner, made)
    if kind == "NodeReroute":
        return _add_shader_opacity(tree, node.inputs[0], made)
    if kind == "ShaderNodeBsdfTransparent":
        if linked_output(color := node.inputs["Color"]) is None:  # Cycles' luminance of white is 1.000001
            return 1.0 - float(LUMINANCE_WEIGHTS @ color.default_value[:3])
        return add_math_output(tree, "SUBTRACT", 1.0, add_node(tree, "RGBToBW", {0: _source_or_number(color)}).outputs[0])
    if kind == "ShaderNodeBsdfPrincipled":
        return _clamp_value(tree, _source_or_number(node.inputs["Alpha"]))
    if kind == "ShaderNodeMixShader":
        share = _clamp_value(tree, _source_or_number(node.inputs[0]))
        if share in (0.0, 1.0):
            return _add_shader_opacity(tree, node.inputs[1 + int(share)], made)
        first, second = _add_shader_opacity(tree, node.inputs[1], made), _add_shader_opacity(tree, node.inputs[2], made)
        if first == second == 1.0:
            return 1.0
        return add_math_output(tree, "MULTIPLY_ADD", share, add_math_output(tree, "SUBTRACT", second, first), first)
    if kind == "ShaderNodeAddShader":
        first, second = (_add_shader_opacity(tree, below, made) for below in node.inputs)
        return _clamp_value(tree, add_math_output(tree, "ADD", add_math_output(tree, "ADD", first, second), -1.0))
    if kind == "ShaderNodeGroup" and node.node_tree is not None:
        return _add_group_opacity(tree, node, given, made)
    if kind == "NodeGroupInput":
        return _ensure_interface_socket(tree, f"{OPACITY_SOCKET} of {given.identifier}", "INPUT", node)
    return 1.0


def _add_group_opacity(tree: Any, node: Any, given: Any, made: dict[Any, Any]) -> Any:
    inner = node.node_tree
    end = group_output_node(inner)
    if end is None:
        return 1.0
    name = f"{OPACITY_SOCKET} of {given.identifier}"
    if name not in [item.name for item in inner.interface.items_tree]:
        below = next(socket for socket in end.inputs if socket.identifier == given.identifier)
        opacity = _add_shader_opacity(inner, below, made)
        _ensure_interface_socket(inner, name, "OUTPUT", end)
        feed_input(inner, end.inputs[name], opacity)
    for shader in [socket for socket in node.inputs if socket.type == "SHADER"]:
        wanted = node.inputs.get(f"{OPACITY_SOCKET} of {shader.identifier}")
        if wanted is not None and not wanted.is_linked:
            feed_input(tree, wanted, _add_shader_opacity(tree, shader, made))
    return node.outputs[name]


def _ensure_interface_socket(tree: Any, name: str, way: str, node: Any) -> Any:
    if name not in [item.name for item in tree.interface.items_tree]:
        tree.interface.new_socket(name, in_out=way, socket_type="NodeSocketFloat")
    return (node.outputs if way == "INPUT" else node.inputs)[name]


def _source_or_number(socket: Any) -> Any:
    """Return the output that a socket is linked to, or its own number."""
    found = linked_output(socket)
    return socket.default_value if found is None else found


def _clamp_value(tree: Any, value: Any) -> Any:
    if isinstance(value, float):
        return min(max(value, 0.0), 1.0)
    return add_math_output(tree, "ADD", value, 0.0, clamp=True)


def show_opacity(material: Any, strength: Callable[[Any], Any] | None = None) -> None:
    """Make a material emit its opacity and nothing else; with `strength`, that strength where it's half opaque."""
    opacity = add_opacity_socket(material)
    tree = material.node_tree
    for node in [node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial"]:
        tree.nodes.remove(node)
    glow = {"Color": (1.0, 1.0, 1.0, 1.0), "Strength": strength(tree) if strength else opacity}
    shader = add_node(tree, "Emission", glow).outputs[0]
    if strength and opacity != 1.0:
        share = add_math_output(tree, "SUBTRACT", 1.0, add_math_output(tree, "LESS_THAN", opacity, 0.5))
        through = add_node(tree, "BsdfTransparent").outputs[0]
        shader = add_node(tree, "MixShader", {0: share, 1: through, 2: shader}).outputs[0]
    add_node(tree, "OutputMaterial", {"Surface": shader})
