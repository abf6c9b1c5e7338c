"""Follow values through node trees, past reroutes, groups, and muted nodes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

Stack = tuple[Any, ...]  # the group nodes that a socket is inside of, the outermost first


def material_output_node(material: Any) -> Any:
    """Return the output node that Cycles uses; None in a damaged tree."""
    tree = material.node_tree
    return tree.get_output_node("CYCLES") if tree is not None and tree.bl_idname == "ShaderNodeTree" else None


def socket_source_and_stack(socket: Any, stack: Stack) -> tuple[Any, Stack] | None:
    """Return the output that a socket is linked to; None if it has its own value."""
    while True:
        if not socket.is_output:
            socket = linked_output(socket)
            if socket is None:
                return None
        node = socket.node
        inner: Any = None
        if node.mute:
            inner = next((link.from_socket for link in node.internal_links if link.to_socket == socket), None)
        elif node.bl_idname == "NodeReroute":
            inner = node.inputs[0]
        elif node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None:
            output = group_output_node(node.node_tree)
            inner = output and _matching_socket(output.inputs, socket)
            stack = (*stack, node)
        elif node.bl_idname == "NodeGroupInput" and stack:
            inner = _matching_socket(stack[-1].inputs, socket)
            stack = stack[:-1]
        if inner is None:
            return socket, stack
        if not inner.is_output and not inner.is_linked:
            return inner, stack
        socket = inner


def upstream_nodes_and_outputs(socket: Any, stack: Stack) -> Iterator[tuple[Any, Any]]:
    """Yield every node that a socket's value depends on, with the output that is used."""
    found = socket_source_and_stack(socket, stack)
    seen = set()
    ring = [found] if found else []
    while ring:
        at, around = ring.pop()
        key = (at.as_pointer(), tuple(node.as_pointer() for node in around))
        if key in seen or not at.is_output:
            continue
        seen.add(key)
        yield at.node, at
        ring += [found for below in at.node.inputs if below.enabled and (found := socket_source_and_stack(below, around))]


def tree_and_nested_trees(tree: Any) -> Iterator[Any]:
    """Yield a node tree and the groups in it, each once."""
    ring, seen = [tree], set()
    while ring:
        at = ring.pop()
        if at.as_pointer() not in seen:
            seen.add(at.as_pointer())
            yield at
            ring += [node.node_tree for node in at.nodes if node.bl_idname == "ShaderNodeGroup" and node.node_tree]


def linked_output(socket: Any) -> Any:
    """Return the output that an input socket is directly linked to; None if there is none."""
    return next((link.from_socket for link in socket.links if link.is_valid and not link.is_muted), None)


def group_output_node(tree: Any) -> Any:
    """Return the output node of a group that counts; None if there is none."""
    outputs = [node for node in tree.nodes if node.bl_idname == "NodeGroupOutput"]
    return next((node for node in outputs if node.is_active_output), outputs[0] if outputs else None)


def _matching_socket(sockets: Any, socket: Any) -> Any:
    return next((other for other in sockets if other.identifier == socket.identifier), None)
