"""Add nodes to shader trees, and link them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy


def add_node(tree: Any, kind: str, inputs: Mapping[Any, Any] | None = None, /, **settings: Any) -> Any:
    """Add a node to a tree; `kind` is its type without "ShaderNode", such as "Math"."""
    node = tree.nodes.new(f"ShaderNode{kind}")
    for name, setting in settings.items():
        setattr(node, name, setting)
    for key, value in (inputs or {}).items():
        feed_input(tree, node.inputs[key], value)
    return node


def feed_input(tree: Any, socket: Any, value: Any) -> None:
    """Link an input to an output, or set it to a value."""
    if isinstance(value, bpy.types.NodeSocket):
        tree.links.new(value, socket)
    else:
        socket.default_value = value


def add_math_output(tree: Any, operation: str, *values: Any, clamp: bool = False) -> Any:
    """Add a math node; return its output."""
    return add_node(tree, "Math", dict(enumerate(values)), operation=operation, use_clamp=clamp).outputs[0]
