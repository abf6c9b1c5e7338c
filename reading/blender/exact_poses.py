"""Poses of a file's objects in float64: Blender's float32 matrices lose meters at map coordinates."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from hulldown.reading.pieces.roles import Link

POSE_TOLERANCE = 16 * float(np.finfo(np.float32).eps)  # relative to the largest number in the chain of matrices


class Poses:
    """Poses and parents of evaluated objects, each computed once.

    A pose is composed in float64 from location, rotation, and scale in the file, up the chain of
    parents. It counts only where it agrees with Blender's float32 matrix to that matrix's rounding: where constraints,
    bones, vertex parents, physics, or particles matter, Blender's matrix is used.
    """

    def __init__(self, depsgraph: Any) -> None:
        self._depsgraph = depsgraph
        self._exact: dict[int, tuple[np.ndarray | None, float]] = {}
        objects = list(depsgraph.objects)
        self._own = dict(zip((obj.original.as_pointer() for obj in objects), _basis_matrices(objects), strict=True))
        self._collections: dict[Any, tuple[str, ...]] = {}
        # The collections that directly contain an object or a collection, which Blender would search for.
        self._around: dict[Any, list[Any]] = defaultdict(list)
        for outer in bpy.data.collections:
            for inner in (*outer.objects, *outer.children):
                self._around[inner].append(outer)

    def pose(self, evaluated: Any) -> Float[np.ndarray, "4 4"]:
        """Return `world_from_object` of an object that isn't an instance."""
        exact, size = self._cached_pose_and_magnitude(evaluated)
        return _exact_pose_if_agreed(exact, size, np.array(evaluated.matrix_world, np.float64))

    def instance_pose(self, instance: Any) -> Float[np.ndarray, "4 4"]:
        """Return `world_from_object` of anything that `depsgraph.object_instances` yields."""
        seen = np.array(instance.matrix_world, np.float64)
        if not instance.is_instance:
            return self.pose(instance.object)
        parent, inner = instance.parent, instance.instance_object
        if _is_none_or_same_object(parent, inner):
            return _exact_pose_if_agreed(*self._cached_pose_and_magnitude(parent), seen)
        if parent.instance_type != "COLLECTION" or parent.instance_collection is None:
            return seen
        outer, outer_size = self._cached_pose_and_magnitude(parent)
        within, inner_size = self._cached_pose_and_magnitude(inner)
        if outer is None or within is None:
            return seen
        offset = np.eye(4)
        offset[:3, 3] = -np.array(parent.instance_collection.instance_offset, np.float64)
        return _exact_pose_if_agreed(outer @ offset @ within, _chain_magnitude(outer, outer_size, inner_size), seen)

    def chain(self, evaluated: Any, delta: Float[np.ndarray, "4 4"] | None = None) -> tuple[Link, ...]:
        """Return `evaluated` and its parents, bones included; `delta` moves their poses to where they are instanced."""
        links: list[Link] = []
        current, moved = evaluated, np.eye(4) if delta is None else delta
        while current is not None:
            links.append(Link(current.name, self._object_collection_names(current), current.type, moved @ self.pose(current)))
            parent = current.parent
            if parent is not None and current.parent_type == "BONE" and parent.pose:
                bone = parent.pose.bones.get(current.parent_bone)
                while bone is not None:
                    posed = self.pose(parent) @ np.array(bone.matrix, np.float64)
                    links.append(Link(bone.name, (), "BONE", moved @ posed))
                    bone = bone.parent
            current = parent
        return tuple(links)

    def _object_collection_names(self, evaluated: Any) -> tuple[str, ...]:
        """Return names of the collections an object is in, nearest first, then those around them."""
        original = evaluated.original
        if original not in self._collections:
            ring, found = self._around[original], dict[Any, None]()
            while ring:
                found.update(dict.fromkeys(ring))
                ring = [outer for inner in ring for outer in self._around[inner] if outer not in found]
            self._collections[original] = tuple(collection.name for collection in found)
        return self._collections[original]

    def _cached_pose_and_magnitude(self, evaluated: Any) -> tuple[np.ndarray | None, float]:
        """Return the pose in float64, None where it can't be composed, and the largest number in the computation."""
        key = evaluated.original.as_pointer()
        if key not in self._exact:
            self._exact[key] = self._compose_pose_and_magnitude(evaluated, key)
        return self._exact[key]

    def _compose_pose_and_magnitude(self, evaluated: Any, key: int) -> tuple[np.ndarray | None, float]:
        own = self._own[key] if key in self._own else _basis_matrices([evaluated])[0]
        if evaluated.parent is None:
            return own, float(np.abs(own).max())
        if evaluated.parent_type != "OBJECT":
            return None, 0.0
        outer, size = self._cached_pose_and_magnitude(evaluated.parent)
        if outer is None:
            return None, 0.0
        inverse = np.array(evaluated.matrix_parent_inverse, np.float64)
        return outer @ inverse @ own, _chain_magnitude(outer @ inverse, size, float(np.abs(own).max()))


def parentless_object_poses(originals: Sequence[Any]) -> Float[np.ndarray, "n 4 4"]:
    """Return `world_from_object` of objects without parents or constraints, which need no evaluation."""
    seen = (np.array(original.matrix_basis, np.float64) for original in originals)
    return np.array(
        [
            _exact_pose_if_agreed(own, float(np.abs(own).max()), at)
            for own, at in zip(_basis_matrices(originals), seen, strict=True)
        ]
    )


def _chain_magnitude(outer: np.ndarray, outer_size: float, inner_size: float) -> float:
    return max(outer_size, float(np.abs(outer[:3, :3]).max()) * inner_size, float(np.abs(outer).max()))


def _exact_pose_if_agreed(exact: np.ndarray | None, size: float, seen: np.ndarray) -> np.ndarray:
    # NaN agrees with nothing.
    if exact is not None and np.abs(exact - seen).max() <= POSE_TOLERANCE * max(size, float(np.abs(seen).max())):
        return exact
    return seen


def _basis_matrices(objects: Sequence[Any]) -> Float[np.ndarray, "n 4 4"]:
    def read(name: str) -> np.ndarray:
        return np.array([getattr(obj, name)[:] for obj in objects], np.float64).reshape(len(objects), -1)

    basis = np.tile(np.eye(4), (len(objects), 1, 1))
    if objects:
        turned = _basis_rotations(objects, "delta_") @ _basis_rotations(objects, "")
        basis[:, :3, :3] = turned * (read("scale") * read("delta_scale"))[:, None]
        basis[:, :3, 3] = read("location") + read("delta_location")
    return basis


def _basis_rotations(objects: Sequence[Any], prefix: str) -> Float[np.ndarray, "n 3 3"]:
    result = np.tile(np.eye(3), (len(objects), 1, 1))
    modes: dict[str, list[int]] = {}
    for i, obj in enumerate(objects):
        modes.setdefault(obj.rotation_mode, []).append(i)
    for mode, those in modes.items():
        if mode == "AXIS_ANGLE" and prefix:  # Blender has no delta axis and angle
            continue
        name = {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}.get(mode, "rotation_euler")
        given = np.array([getattr(objects[i], prefix + name)[:] for i in those], np.float64)
        if mode == "QUATERNION":
            some = np.linalg.norm(given, axis=1) > 0.0
            turned = Rotation.from_quat(given[some][:, [1, 2, 3, 0]])
        elif mode == "AXIS_ANGLE":
            length = np.linalg.norm(given[:, 1:], axis=1)
            some = length > 0.0
            turned = Rotation.from_rotvec(given[some, :1] * given[some, 1:] / length[some, None])
        else:
            some = np.ones(len(given), bool)
            turned = Rotation.from_euler(mode.lower(), given[:, ["XYZ".index(axis) for axis in mode]])
        result[np.array(those)[some]] = turned.as_matrix()
    return result


def _is_none_or_same_object(a: Any, b: Any) -> bool:
    return b is None or a.original.as_pointer() == b.original.as_pointer()
