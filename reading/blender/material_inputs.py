"""What materials read of the objects that have them, kept for the objects of a tidy twin.

A random number follows from an object's name, an attribute from its custom properties or its instancer, a position from
its place in the file. A twin's objects have other names, instancers, and places. So reading takes the values, and the
materials of a twin read them from custom properties of its objects, and attributes of its instances.

References
----------
Blender 5.0, intern/cycles/blender/object.cpp (random numbers, particles, attributes) and
source/blender/blenkernel/intern/object_dupli.cc (where attributes are looked up).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from hulldown.reading.blender.api.buffers import STORED, read
from hulldown.reading.blender.surfaces.input_nodes import (
    COORDINATES,
    OBJECT_INFO,
    PARTICLE,
    UV_MAP,
    placed_objects,
    reads,
)
from hulldown.reading.pieces.roles import Key, Value

NONE: Value = (0.0, 0.0, 0.0, 0.0)
NODED = ("MESH", "CURVE", "SURFACE", "FONT", "CURVES", "POINTCLOUD", "VOLUME")  # may have geometry nodes
TURN = 1.0 / 0xFFFFFFFF
CLOSE = 1e-4  # between a pose that Blender draws an instance at and that of its points


@dataclass(eq=False)
class ObjectInputs:
    """Values that materials read of the objects of a depsgraph."""

    materials: Sequence[Any]
    keys: tuple[Key, ...] = ()  # names of the values, from `reads`
    # world_from_object in the file of the objects whose coordinates materials read, by name
    places: dict[str, np.ndarray] = field(default_factory=dict)
    _instances: dict[int, tuple[KDTree, dict[str, np.ndarray]] | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.keys = reads(self.materials)

    def start(self, depsgraph: Any) -> None:
        """Begin to read a depsgraph."""
        self._scene, self._layer = depsgraph.scene, depsgraph.view_layer
        self.places = {
            obj.name_full: np.array(obj.evaluated_get(depsgraph).matrix_world, np.float64)
            for obj in placed_objects(self.materials)
        }

    def values(self, instance: Any) -> tuple[Value, ...]:
        """Return the value of each key for anything that `depsgraph.object_instances` yields."""
        return tuple(self._value(instance, *key) for key in self.keys)

    def of_duplicate(self, values: Sequence[Value], name: str, pose: Float[np.ndarray, "4 4"]) -> tuple[Value, ...]:
        """Return the values of an object that differs in name and pose alone."""
        own = {
            (OBJECT_INFO, "Random"): _number(random_number(name)),
            (OBJECT_INFO, "Location"): _vector(pose[:3, 3].tolist()),
        }
        return tuple(own.get(key, value) for key, value in zip(self.keys, values, strict=True))

    def _value(self, instance: Any, kind: str, name: str) -> Value:
        obj = instance.object
        if kind == OBJECT_INFO and name == "Random":
            given = (instance.random_id % 2**32) * TURN if instance.is_instance else random_number(obj.name)
            return _number(given)
        if kind == OBJECT_INFO:
            return _vector(instance.matrix_world.translation)
        if kind == PARTICLE:
            return self._of_particle(instance, name)
        if kind in (COORDINATES, UV_MAP):
            return _vector([0.5 * at - 0.5 for at in instance.orco] if name == "Generated" else (*instance.uv, 0.0))
        if kind == "VIEW_LAYER":
            return found_property((self._layer, self._scene, self._scene.world), name)
        if kind == "INSTANCER" and instance.is_instance:
            system = instance.particle_system
            if system and (value := own_property(system.settings, name)):
                return value
            if value := self._of_points(instance, name):
                return value
            return found_property((instance.parent, obj, obj.data), name)
        return found_property((obj, obj.data), name)

    def _of_particle(self, instance: Any, name: str) -> Value:
        system, index = instance.particle_system, instance.persistent_id[0] if instance.is_instance else 0
        particle = system.particles[index] if system and 0 <= index < len(system.particles) else None
        index = index if particle else 0  # those without a particle have the number 0
        if name in ("Index", "Random"):
            return _number(index if name == "Index" else hashed(index, 0) * TURN)
        if particle is None:
            return NONE
        if name == "Age":
            return _number(self._scene.frame_current - particle.birth_time)
        return _as_value(getattr(particle, name.lower().replace(" ", "_"))) or NONE

    def _of_points(self, instance: Any, name: str) -> Value | None:
        """Return an attribute that geometry nodes gave an instance; None if there is none."""
        parent = instance.parent
        key = parent.original.as_pointer()
        if key not in self._instances:
            self._instances[key] = _instances_of(parent)
        found = self._instances[key]
        if found is None or name not in found[1]:
            return None
        off, nearest = found[0].query(np.array(instance.matrix_world, np.float64)[:3].ravel())
        return _as_value(found[1][name][nearest].tolist()) if off < CLOSE else None


def random_number(name: str) -> float:
    """Cycles' random number of an object that is no instance, in 0 to 1."""
    total = 0
    for byte in name.encode("utf-8", "surrogateescape"):
        total = (total * 37 + byte) % 2**32
    return hashed(total, 0) * TURN


def hashed(first: int, second: int) -> int:
    """Hash two numbers of 32 bits to one.

    References
    ----------
    Bob Jenkins, lookup3.c, 2006: the macro `final`.
    """
    a = b = c = 0xDEADBEEF + (2 << 2) + 13
    a, b = (a + first) % 2**32, (b + second) % 2**32

    def turned(x: int, bits: int) -> int:
        return (x << bits | x >> (32 - bits)) % 2**32

    c = ((c ^ b) - turned(b, 14)) % 2**32
    a = ((a ^ c) - turned(c, 11)) % 2**32
    b = ((b ^ a) - turned(a, 25)) % 2**32
    c = ((c ^ b) - turned(b, 16)) % 2**32
    a = ((a ^ c) - turned(c, 4)) % 2**32
    b = ((b ^ a) - turned(a, 14)) % 2**32
    return ((c ^ b) - turned(b, 24)) % 2**32


def found_property(owners: Iterable[Any], name: str) -> Value:
    """Return the property of the first of these data that has it, as an attribute node gives it; zeros if none has."""
    found = (own_property(owner, name) for owner in owners if owner is not None)
    return next((value for value in found if value is not None), NONE)


def own_property(owner: Any, name: str) -> Value | None:
    """Return a property of an object or other data as an attribute node gives it; None if it has none."""
    if name in owner:
        return _as_value(owner[name])
    try:
        return _as_value(owner.path_resolve(name))
    except (ValueError, TypeError):
        return None


def _as_value(given: Any) -> Value | None:
    """Return a number or a few of them as Blender makes an attribute of them; None for anything else."""
    if isinstance(given, bool | int | float):
        return _number(given)
    try:
        numbers = [float(number) for number in given]
    except (TypeError, ValueError):
        return None
    if isinstance(given, str) or not 1 <= len(numbers) <= 4:
        return None
    padded = [*numbers, *NONE[len(numbers) : 3], 1.0][:4]
    return padded[0], padded[1], padded[2], padded[3]


def _number(given: float) -> Value:
    return float(given), float(given), float(given), 1.0


def _vector(given: Sequence[float]) -> Value:
    return float(given[0]), float(given[1]), float(given[2]), 1.0


def _instances_of(parent: Any) -> tuple[KDTree, dict[str, np.ndarray]] | None:
    """Poses in the file of the instances that geometry nodes give an object, and their attributes; None if none."""
    if parent.type not in NODED:  # Blender 5.2 refuses others
        return None
    geometry = parent.evaluated_geometry()  # which has the points for as long as it exists
    points = geometry.instances_pointcloud()
    if points is None or not len(points.points):
        return None
    found = {}
    for attribute in points.attributes:
        stored = STORED.get(attribute.data_type)
        if stored is not None and len(attribute.data):
            found[attribute.name] = read(attribute.data, *stored).reshape(len(attribute.data), stored[2])
    poses = found["instance_transform"].reshape(-1, 4, 4).swapaxes(1, 2)
    world = np.array(parent.matrix_world, np.float64) @ poses
    return KDTree(world[:, :3].reshape(len(world), -1)), found
