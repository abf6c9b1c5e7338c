"""Tell why objects of a file are hidden: from the viewport, the camera, or the render."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hulldown.blender.shaders import is_volume_only_material
from hulldown.reading.blender.duplicates import Duplicate
from hulldown.reading.pieces.asset_report import By, ObjectRow
from hulldown.reading.pieces.roles import Evaluated, Unseen

SURFACE_TYPES = ("MESH", "CURVE", "SURFACE", "FONT", "META")
SOLID_TYPES = ("MESH", "CURVES", "POINTCLOUD")
UNDRAWN_TYPES = {
    "GREASEPENCIL": "grease pencil is not rendered by Cycles",
    "VOLUME": "a volume hides nothing as a surface, and isn't rendered",
}
DRAWN_TYPES = (*SURFACE_TYPES, *SOLID_TYPES, *UNDRAWN_TYPES)
ACTIVE_CAMERA = "GeometryNodeInputActiveCamera"


def add_hidden_object_rows(scene: Any, result: Evaluated, duplicates: Mapping[str, Sequence[Duplicate]]) -> None:
    """Add rows for objects of the file that aren't rendered to the result."""
    drawn = {link.name for piece in result.pieces for link in piece.chain} | {left.name for left in result.left}
    layer = next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])
    off = dict(_collection_hidden_flags(layer.layer_collection, False))
    for obj in scene.objects:
        if obj.name not in drawn and obj.type in DRAWN_TYPES:
            for name in (obj.name, *(duplicate.name for duplicate in duplicates.get(obj.name_full, ()))):
                why, by = _hidden_reason_and_decider(obj, off)
                result.left[ObjectRow(name, obj.type, "dropped", why, by=by)] += 1


def _collection_hidden_flags(layer: Any, already: bool) -> Iterator[tuple[str, bool]]:
    off = already or layer.exclude or layer.collection.hide_render
    yield layer.collection.name, off
    for inner in layer.children:
        yield from _collection_hidden_flags(inner, off)


def _hidden_reason_and_decider(obj: Any, off: Mapping[str, bool]) -> tuple[str, By]:
    around = [c.name for c in obj.users_collection if c.name in off]
    if obj.hide_render:
        return "hidden from render", By.HIDDEN
    if around and all(off[name] for name in around):
        return f"hidden from render with its collection {around[0]!r}", By.HIDDEN
    return "not in the render, or without a surface", By.FILE


def why_unseen(drawn: Any, depsgraph: Any) -> Unseen | None:
    """Return the reason why the camera doesn't see an object although it's drawn; None if it does."""
    original = drawn.original
    if not drawn.visible_camera:
        return Unseen.RAY_VISIBILITY
    if drawn.is_shadow_catcher:
        return Unseen.SHADOW_CATCHER
    if drawn.is_holdout or original.holdout_get(view_layer=depsgraph.view_layer):
        return Unseen.HOLDOUT
    if original.indirect_only_get(view_layer=depsgraph.view_layer):
        return Unseen.INDIRECT_ONLY
    materials = [s.material for s in drawn.material_slots]
    if materials and all(m is not None and is_volume_only_material(m) for m in materials):
        return Unseen.VOLUME
    return None


def is_hidden_in_viewport(original: Any) -> bool:
    """Return whether the eye or monitor icon of an object or its collection hides it."""
    return bool(original.hide_viewport or not original.visible_get())


def camera_dependence_reason(obj: Any) -> str:
    """Describe how an object, or what carries it, is drawn if that depends on a camera; empty if it doesn't."""
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
        node.bl_idname == ACTIVE_CAMERA or (node.type == "GROUP" and _reads_camera(node.node_tree)) for node in tree.nodes
    )
