"""The opacity of a material as a socket of its node tree, which Cycles evaluates for baking and masks.

Nodes compute here what `reading.blender.surfaces.opacity` reads from a tree.
"""

from __future__ import annotations

from typing import Any

from hulldown.reading.blender.surfaces.nodes import add_math, give, group_output, linked, material_output

SOCKET = "hulldown opacity"


def opacity_socket(material: Any) -> Any:
    """An output socket with the material's opacity, or a number if it's constant.

    Nodes are added to the tree and its groups; the material stays as opaque as before.
    """
    output = material_output(material)
    return _opacity(material.node_tree, output.inputs["Surface"], {}) if output else 1.0


def _opacity(tree: Any, socket: Any, made: dict[Any, Any]) -> Any:
    """Opacity of the shader linked to an input socket."""
    given = linked(socket)
    if given is None:
        return 1.0
    key = (tree.as_pointer(), given.as_pointer())
    if key not in made:
        made[key] = _of_output(tree, given.node, given, made)
    return made[key]


def _of_output(tree: Any, node: Any, given: Any, made: dict[Any, Any]) -> Any:
    kind = node.bl_idname
    if node.mute:
        inner = next((link.from_socket for link in node.internal_links if link.to_socket == given), None)
        return 1.0 if inner is None else _opacity(tree, inner, made)
    if kind == "NodeReroute":
        return _opacity(tree, node.inputs[0], made)
    if kind == "ShaderNodeBsdfTransparent":
        return add_math(tree, "SUBTRACT", 1.0, _gray(tree, node.inputs["Color"]))
    if kind == "ShaderNodeBsdfPrincipled":
        return _clamped(tree, _own(node.inputs["Alpha"]))
    if kind == "ShaderNodeMixShader":
        share = _clamped(tree, _own(node.inputs[0]))
        first, second = _opacity(tree, node.inputs[1], made), _opacity(tree, node.inputs[2], made)
        if first == second == 1.0:
            return 1.0
        return add_math(tree, "MULTIPLY_ADD", share, add_math(tree, "SUBTRACT", second, first), first)
    if kind == "ShaderNodeAddShader":
        first, second = (_opacity(tree, below, made) for below in node.inputs)
        return _clamped(tree, add_math(tree, "ADD", add_math(tree, "ADD", first, second), -1.0))
    if kind == "ShaderNodeGroup" and node.node_tree is not None:
        return _of_group(tree, node, given, made)
    if kind == "NodeGroupInput":
        return _interface(tree, f"{SOCKET} of {given.identifier}", "INPUT", node)
    return 1.0


def _of_group(tree: Any, node: Any, given: Any, made: dict[Any, Any]) -> Any:
    inner = node.node_tree
    end = group_output(inner)
    if end is None:
        return 1.0
    name = f"{SOCKET} of {given.identifier}"
    if name not in [item.name for item in inner.interface.items_tree]:
        below = next(socket for socket in end.inputs if socket.identifier == given.identifier)
        opacity = _opacity(inner, below, made)
        _interface(inner, name, "OUTPUT", end)
        give(inner, opacity, end.inputs[name])
    for shader in [socket for socket in node.inputs if socket.type == "SHADER"]:
        wanted = node.inputs.get(f"{SOCKET} of {shader.identifier}")
        if wanted is not None and not wanted.is_linked:
            give(tree, _opacity(tree, shader, made), wanted)
    return node.outputs[name]


def _interface(tree: Any, name: str, way: str, node: Any) -> Any:
    """The socket of a group's own input or output node of this name, made if it is not there."""
    if name not in [item.name for item in tree.interface.items_tree]:
        tree.interface.new_socket(name, in_out=way, socket_type="NodeSocketFloat")
    return (node.outputs if way == "INPUT" else node.inputs)[name]


def _own(socket: Any) -> Any:
    """The source of a socket's value: the linked output, or its number."""
    found = linked(socket)
    return socket.default_value if found is None else found


def _gray(tree: Any, socket: Any) -> Any:
    to_gray = tree.nodes.new("ShaderNodeRGBToBW")
    give(tree, _own(socket), to_gray.inputs[0])
    return to_gray.outputs[0]


def _clamped(tree: Any, value: Any) -> Any:
    if isinstance(value, float):
        return min(max(value, 0.0), 1.0)
    return add_math(tree, "ADD", value, 0.0, clamp=True)


def show_opacity(material: Any, *, hard: bool, strength: Any = None) -> None:
    """Make a material emit its opacity and nothing else.

    Parameters
    ----------
    material
        Changed, with its groups.
    hard
        Whether it emits where it's at least half opaque and is invisible elsewhere. Otherwise it emits everywhere,
        in proportion to its opacity.
    strength
        Called with the tree for the socket that has the strength of a hard material's glow.
    """
    opacity = opacity_socket(material)
    tree = material.node_tree
    for node in [node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial"]:
        tree.nodes.remove(node)
    output, glow = tree.nodes.new("ShaderNodeOutputMaterial"), tree.nodes.new("ShaderNodeEmission")
    glow.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    shader = glow.outputs[0]
    if not hard:
        give(tree, opacity, glow.inputs["Strength"])
    else:
        tree.links.new(strength(tree), glow.inputs["Strength"])
        if opacity != 1.0:
            mix, through = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
            give(tree, add_math(tree, "SUBTRACT", 1.0, add_math(tree, "LESS_THAN", opacity, 0.5)), mix.inputs[0])
            tree.links.new(through.outputs[0], mix.inputs[1])
            tree.links.new(shader, mix.inputs[2])
            shader = mix.outputs[0]
    tree.links.new(shader, output.inputs["Surface"])
