"""Take objects that differ in names and pose alone out of the scene before evaluation, which costs 1 ms each."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float

from hulldown.blender.buffers import STORED_TYPES, read_property
from hulldown.reading.blender.exact_poses import parentless_object_poses
from hulldown.reading.blender.tidy import look_attribute_values

MIN_OBJECTS = 1000  # smaller files are read as they are
HARMLESS_USERS = ("Scene", "Collection", "Screen", "WorkSpace", "WindowManager")  # objects may have such users


@dataclass(frozen=True, eq=False, slots=True)
class Duplicate:
    """An object that was taken out of the scene."""

    name: str
    data: str
    pose: Float[np.ndarray, "4 4"]  # world_from_object


def remove_duplicate_objects() -> dict[str, list[Duplicate]]:
    """Remove duplicates before evaluation, if there are many; return them by the name of the object that stays."""
    groups = [same for same in _equal_object_groups().values() if len(same) > 1]
    if sum(len(same) - 1 for same in groups) < MIN_OBJECTS:
        return {}
    duplicates = {
        same[0].name: [
            Duplicate(obj.name, obj.data.name, pose)
            for obj, pose in zip(same[1:], parentless_object_poses(same[1:]), strict=True)
        ]
        for same in groups
    }
    meshes = {obj.data for same in groups for obj in same[1:]}
    bpy.data.batch_remove([obj for same in groups for obj in same[1:]])
    bpy.data.batch_remove([mesh for mesh in meshes if not mesh.users])
    return duplicates


def _equal_object_groups() -> dict[tuple[object, ...], list[Any]]:
    users = bpy.data.user_map()
    plain = [obj for obj in bpy.data.objects if _is_plain_mesh_object(obj) and _has_only_harmless_users(users.get(obj, set()))]
    within: dict[Any, list[Any]] = defaultdict(list)
    for collection in (*bpy.data.collections, *(scene.collection for scene in bpy.data.scenes)):
        for obj in collection.objects:
            within[obj].append(collection)
    ordinary = {
        collection for collection in bpy.data.collections if _has_only_harmless_users(_all_collection_users(collection, users))
    }
    ordinary.update(scene.collection for scene in bpy.data.scenes)
    cameras = {scene.camera for scene in bpy.data.scenes}
    cameras.update(marker.camera for scene in bpy.data.scenes for marker in scene.timeline_markers)
    content = _content_key_by_mesh({obj.data for obj in plain if not obj.vertex_groups})
    alike: dict[tuple[object, ...], list[Any]] = defaultdict(list)
    for obj in plain:
        if obj not in cameras and ordinary.issuperset(within[obj]):
            alike[content.get(obj.data, obj.data), tuple(within[obj]), _object_look_key(obj)].append(obj)
    return alike


def _content_key_by_mesh(meshes: set[Any]) -> dict[Any, object]:
    sizes: dict[tuple[int, int, int], list[Any]] = defaultdict(list)
    for mesh in meshes:
        sizes[len(mesh.vertices), len(mesh.loops), len(mesh.polygons)].append(mesh)
    return {mesh: _mesh_content_key(mesh) for same in sizes.values() if len(same) > 1 for mesh in same}


def _mesh_content_key(mesh: Any) -> object:
    """Return a key of how a mesh is drawn; the mesh itself if it's damaged or has content that can't be compared."""
    if mesh.library or mesh.override_library or mesh.keys():
        return mesh
    stored = hashlib.sha256()
    try:
        stored.update(read_property(mesh.polygons, "loop_start", np.int32).tobytes())
    except TypeError:  # in a damaged file, faces may have no corners
        return mesh
    kinds = []
    for attribute in sorted(mesh.attributes, key=lambda attribute: str(attribute.name)):
        if attribute.data_type not in STORED_TYPES:
            return mesh
        values = read_property(attribute.data, *STORED_TYPES[attribute.data_type])
        stored.update(values.tobytes())
        kinds.append((attribute.name, attribute.domain, attribute.data_type, len(values)))
    own_space = None if mesh.use_auto_texspace else (*mesh.texspace_location, *mesh.texspace_size)
    return (
        *(tuple(kinds), stored.digest(), own_space, mesh.texco_mesh, mesh.attributes.default_color_name),
        tuple((layer.name, layer.active_render) for layer in mesh.uv_layers),
    )


def _is_plain_mesh_object(obj: Any) -> bool:
    """Return whether an object draws its mesh at its own location, rotation, and scale, and nothing else."""
    if obj.type != "MESH" or obj.library or obj.override_library or obj.animation_data or obj.parent:
        return False
    if obj.modifiers or obj.constraints or obj.particle_systems or obj.instance_type != "NONE":
        return False
    if obj.rigid_body or obj.rigid_body_constraint or (obj.field and obj.field.type != "NONE"):
        return False
    if obj.hide_render or obj.hide_viewport or obj.hide_get() or obj.mode != "OBJECT":
        return False
    return not (obj.data.shape_keys or obj.data.animation_data) and bool(np.isfinite(obj.matrix_basis).all())


def _has_only_harmless_users(users: set[Any]) -> bool:
    return all(user.bl_rna.identifier in HARMLESS_USERS for user in users)


def _all_collection_users(collection: Any, users: dict[Any, set[Any]]) -> set[Any]:
    found: set[Any] = set()
    ring = [collection]
    while ring:
        more = users.get(ring.pop(), set()) - found
        found |= more
        ring += [user for user in more if isinstance(user, bpy.types.Collection)]
    return found


def _object_look_key(obj: Any) -> tuple[object, ...]:
    slots = tuple((slot.link, slot.material) for slot in obj.material_slots)
    return (*look_attribute_values(obj), obj.is_holdout, obj.is_shadow_catcher, slots)
