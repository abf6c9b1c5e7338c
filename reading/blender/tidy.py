"""The tidy twin of a file for the renderer: everything drawn, as plain posed data with its materials.

Vehicles: every object has the index of its part and its pose in the vehicle frame, see `blender.tidy_properties`.
Sceneries: in meters, z up, relative to the origin. Neither has a scene: Blender 5.2 crashes when one is written.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float

from hulldown.blender.frames import set_object_pose as set_object_pose
from hulldown.blender.tidy_properties import PART_PROPERTY, RANDOM_PROPERTY, REST_PROPERTY, VISIBILITY_FLAGS
from hulldown.reading.blender.surfaces.object_inputs import detach_materials_from_objects
from hulldown.reading.pieces.roles import Evaluated, Piece, PieceRole, Unseen

CUT_OUT_USES = (Unseen.SHADOW_CATCHER, Unseen.HOLDOUT)
MIN_MERGED_COPIES = 8  # one object draws so many copies or more
POSE_PROPERTY = "pose"
LOOK_ATTRIBUTES = (*VISIBILITY_FLAGS, "pass_index", "color")


def data_outliving_depsgraph(drawn: Any, materials: Sequence[Any]) -> Any:
    """Return an object's data, such as a mesh, with evaluated materials, in a form that outlives the depsgraph."""
    data = drawn.data
    wanted = [material.original if material else None for material in materials]
    if _equals_original_mesh(drawn, data, wanted):
        return drawn.original.data
    mesh = data.copy()
    mesh.animation_data_clear()
    if isinstance(data, bpy.types.Mesh):  # generated coordinates are those of the file's mesh
        mesh.use_auto_texspace = False
        mesh.texspace_location, mesh.texspace_size = data.texspace_location, data.texspace_size
    for slot, material in enumerate(wanted[: len(mesh.materials)]):
        mesh.materials[slot] = material
    return mesh


def look_attribute_values(drawn: Any) -> tuple[object, ...]:
    """Return the look that a piece's object adds to its mesh: values of `LOOK_ATTRIBUTES`."""
    return (*(getattr(drawn, name) for name in VISIBILITY_FLAGS), drawn.pass_index, tuple(drawn.color))


def _equals_original_mesh(drawn: Any, data: Any, materials: Sequence[Any]) -> bool:
    obj, file = drawn.original, drawn.original.data
    if not isinstance(file, bpy.types.Mesh) or not isinstance(data, bpy.types.Mesh):
        return False
    if file.library or file.override_library or file.animation_data or file.shape_keys:
        return False
    # Lattices and armatures bend their children without a modifier.
    if obj.modifiers or obj.parent_type in ("ARMATURE", "LATTICE") or obj.mode != "OBJECT":
        return False
    same = all(len(getattr(data, part)) == len(getattr(file, part)) for part in ("vertices", "loops", "polygons"))
    return same and list(file.materials) == list(materials)


def write_tidy_vehicle(
    path: Path, drawn: Evaluated, piece_part: Sequence[int], vehicle_from_file: Float[np.ndarray, "4 4"]
) -> Any:
    """Write the pieces whose part is not -1."""
    collection = bpy.data.collections.new("hulldown vehicle")
    detach_materials_from_objects(bpy.data.materials)
    for piece, part in zip(drawn.pieces, piece_part, strict=True):
        if part < 0:
            continue
        rest = vehicle_from_file @ piece.pose
        obj = _make_piece_object(piece, drawn.blocks[piece.mesh])
        obj[PART_PROPERTY] = int(part)
        obj[REST_PROPERTY] = rest.ravel().tolist()
        collection.objects.link(obj)
    bpy.data.libraries.write(str(path), {collection}, path_remap="ABSOLUTE", compress=True)
    return collection


def _make_piece_object(piece: Piece, block: Any) -> Any:
    obj = bpy.data.objects.new(piece.name, block)
    for name, value in zip(LOOK_ATTRIBUTES, piece.look, strict=True):
        setattr(obj, name, value)
    obj[RANDOM_PROPERTY] = piece.random
    return obj


def write_tidy_scenery(
    path: Path, drawn: Evaluated, roles: Sequence[PieceRole], scenery_from_file: Float[np.ndarray, "4 4"]
) -> None:
    """Write everything drawn, except backdrops and removed objects, as one collection."""
    collection = bpy.data.collections.new("hulldown scenery")
    detach_materials_from_objects(bpy.data.materials)
    root = bpy.data.objects.new("hulldown scenery", None)
    collection.objects.link(root)
    alike: dict[tuple[int, tuple[object, ...]], list[Piece]] = defaultdict(list)
    for piece, role in zip(drawn.pieces, roles, strict=True):
        if role.use not in ("backdrop", "removed") and piece.unseen not in CUT_OUT_USES:
            alike[piece.mesh, piece.look].append(piece)
    # Blender keeps objects sorted by name and looks for the place of a new one from the end.
    for same in sorted(alike.values(), key=lambda same: same[0].name.lower()):
        poses = scenery_from_file @ np.array([piece.pose for piece in same])
        if len(same) >= MIN_MERGED_COPIES:
            thing = _make_piece_object(same[0], drawn.blocks[same[0].mesh])
            collection.objects.link(_make_instancing_object(thing, poses, [piece.random for piece in same]))
            continue
        for piece, world_from_mesh in zip(same, poses, strict=True):
            obj = _make_piece_object(piece, drawn.blocks[piece.mesh])
            obj.parent = root
            set_object_pose(obj, world_from_mesh)
            collection.objects.link(obj)
    bpy.data.libraries.write(str(path), {collection}, path_remap="ABSOLUTE", compress=True)


def _make_instancing_object(thing: Any, poses: Float[np.ndarray, "k 4 4"], numbers: Sequence[float]) -> Any:
    """Return one object that draws `thing` in all these poses, since ten thousand objects take minutes."""
    points = bpy.data.meshes.new(thing.name)
    points.vertices.add(len(poses))
    # Blender stores matrices column by column.
    flat = np.ascontiguousarray(np.swapaxes(poses, 1, 2), dtype=np.float32).ravel()
    points.attributes.new(POSE_PROPERTY, "FLOAT4X4", "POINT").data.foreach_set("value", flat)
    points.attributes.new(RANDOM_PROPERTY, "FLOAT", "POINT").data.foreach_set("value", numbers)
    group = bpy.data.node_groups.new(f"draw {thing.name}", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    nodes, link = group.nodes, group.links.new
    given, result = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    drawn = nodes.new("GeometryNodeObjectInfo")
    drawn.inputs["Object"].default_value, drawn.inputs["As Instance"].default_value = thing, True
    on_points = nodes.new("GeometryNodeInstanceOnPoints")
    named = nodes.new("GeometryNodeInputNamedAttribute")
    named.data_type, named.inputs["Name"].default_value = "FLOAT4X4", POSE_PROPERTY
    posed = nodes.new("GeometryNodeSetInstanceTransform")
    link(given.outputs[0], on_points.inputs["Points"])
    link(drawn.outputs["Geometry"], on_points.inputs["Instance"])
    link(on_points.outputs["Instances"], posed.inputs["Instances"])
    link(named.outputs["Attribute"], posed.inputs["Transform"])
    link(posed.outputs[0], result.inputs[0])
    carrier = bpy.data.objects.new(f"{thing.name} x {len(poses)}", points)
    carrier.modifiers.new("draw", "NODES").node_group = group
    return carrier
