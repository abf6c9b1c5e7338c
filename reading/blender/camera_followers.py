"""Find objects whose shape or place depends on a camera, which pictures have in other places than the file."""

from __future__ import annotations

from typing import Any

ACTIVE_CAMERA = "GeometryNodeInputActiveCamera"


def follows_camera(obj: Any) -> str:
    """Return how an object, or what carries it, is drawn if that depends on a camera; empty if it doesn't."""
    while obj is not None:
        for modifier in obj.modifiers:
            if modifier.type == "NODES" and modifier.show_render and _reads_camera(modifier.node_group):
                return "drawn as geometry nodes make it for a camera at the origin, in every picture"
        targets = [constraint.target for constraint in obj.constraints if getattr(constraint, "target", None)]
        obj = obj.parent
        if any(each is not None and each.type == "CAMERA" for each in (obj, *targets)):
            return "drawn as it follows the file's camera, which stays where it is, in every picture"
    return ""


def _reads_camera(tree: Any) -> bool:
    if tree is None:
        return False
    return any(
        node.bl_idname == ACTIVE_CAMERA or (node.type == "GROUP" and _reads_camera(node.node_tree))
        for node in tree.nodes
    )
