"""Looks at scenes by rays, for people: surfaces, their normals, a sun with shadows, a sky, fog."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from camera.target import Part
from camera.visibility import Plane
from geometry.instances import InstancedScene
from geometry.meshes import Mesh
from geometry.rays import RayCaster
from geometry.transforms import apply, invert_rigid

_ZENITH, _HORIZON = np.array([0.36, 0.55, 0.82]), np.array([0.78, 0.84, 0.92])
_AMBIENT = 0.45  # of the light comes from the whole sky, the rest from the sun
_SUN_ELEVATION = math.radians(40.0)
_TILES_M = 5.0  # a faint chequer on the ground, so that sizes can be judged
_EXTINCTION = 3.912  # over the meteorological visibility: contrast has fallen to 2 % there


@runtime_checkable
class Surface(Protocol):
    """Something to look at."""

    def meet(
        self, origin: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"], reach: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Distances, inf on a miss within reach, and normals of any length and side."""
        ...

    def blocks(self, origin: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether it lies along each ray."""
        ...

    def colours(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Its colours at points on it."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class Ground:
    """The ground: a mesh, or the endless plane."""

    mesh: Mesh | None
    rays: RayCaster | Plane

    def meet(
        self, origin: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"], reach: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """As `Surface` says."""
        if isinstance(self.rays, RayCaster):
            assert self.mesh is not None
            hits = self.rays.cast(origin, along, max_distance=reach)
            return hits.distance, _normals(self.mesh, hits.face)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (self.rays.z - origin[:, 2]) / along[:, 2]
        return np.where(distance > 0.0, distance, np.inf), np.tile([0.0, 0.0, 1.0], (len(along), 1))

    def blocks(self, origin: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """As `Surface` says."""
        return self.rays.occluded(origin, along)

    def colours(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """As `Surface` says."""
        odd = np.floor(points[:, :2] / _TILES_M).sum(axis=1) % 2.0
        return np.array([0.52, 0.49, 0.36]) * (1.0 - 0.07 * odd)[:, None]


@dataclass(frozen=True, eq=False, slots=True)
class Obstacles:
    """Trees, boulders, houses."""

    scene: InstancedScene

    def meet(
        self, origin: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"], reach: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """As `Surface` says."""
        hits = self.scene.cast(origin, along, max_distance=reach)
        normal = np.zeros_like(along)
        for instance in np.unique(hits.instance[hits.hit]):
            mine = hits.instance == instance
            mesh = self.scene.meshes[int(self.scene.instance_mesh[instance])]
            # The pseudo-inverse, since an instance may be squashed flat.
            normal[mine] = _normals(mesh, hits.face[mine]) @ np.linalg.pinv(
                self.scene.world_from_instance[instance, :3, :3]
            )
        return hits.distance, normal

    def blocks(self, origin: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """As `Surface` says."""
        return self.scene.occluded(origin, along)

    def colours(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """As `Surface` says."""
        return np.broadcast_to([0.25, 0.36, 0.19], points.shape)


@dataclass(frozen=True, eq=False, slots=True)
class VehiclePart:
    """A part of a vehicle where it stands."""

    part: Part
    mesh: Mesh
    world_from_part: Float[np.ndarray, "4 4"]
    colour: Float[np.ndarray, "3"]

    def meet(
        self, origin: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"], reach: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """As `Surface` says."""
        hits = self.part.caster.cast(*self._inside(origin, along), max_distance=reach)
        return hits.distance, _normals(self.mesh, hits.face) @ self.world_from_part[:3, :3].T

    def blocks(self, origin: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """As `Surface` says."""
        return self.part.caster.occluded(*self._inside(origin, along))

    def colours(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """As `Surface` says."""
        return np.broadcast_to(self.colour, points.shape)

    def _inside(
        self, origin: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        return apply(invert_rigid(self.world_from_part), origin), along @ self.world_from_part[:3, :3]


def look(
    surfaces: Sequence[Surface],
    origin: Float[np.ndarray, "n 3"],
    along: Float[np.ndarray, "n 3"],
    *,
    sun: Float[np.ndarray, "3"],
    strength: float = 1.0,
    visibility_m: float | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Colours from 0 to 1 of what rays with unit directions meet.

    Parameters
    ----------
    surfaces
        Everything there is besides the sky.
    origin, along
        (n, 3) rays.
    sun
        (3,) unit direction to it.
    strength
        Factor on all light.
    visibility_m
        Meteorological visibility of the fog, if there is any.
    """
    nearest, of = np.full(len(along), np.inf), np.full(len(along), -1)
    normal = np.zeros_like(along)
    for k, surface in enumerate(surfaces):
        distance, facing = surface.meet(origin, along, nearest)
        closer = distance < nearest
        nearest[closer], normal[closer], of[closer] = distance[closer], facing[closer], k
    height = np.clip(along[:, 2], 0.0, 1.0)[:, None]
    sky = _HORIZON + (_ZENITH - _HORIZON) * np.sqrt(height)
    colour = sky.copy()
    met = np.flatnonzero(of >= 0)
    points = origin[met] + nearest[met, None] * along[met]
    albedo = np.empty_like(points)
    for k, surface in enumerate(surfaces):
        mine = of[met] == k
        if mine.any():
            albedo[mine] = surface.colours(points[mine])
    length = np.linalg.norm(normal[met], axis=1, keepdims=True)
    unit = normal[met] / np.where(length > 0.0, length, 1.0)
    # Winding carries no meaning: a surface faces whoever looks at it.
    unit = np.where((unit * along[met]).sum(axis=1, keepdims=True) > 0.0, -unit, unit)
    direct = np.clip(unit @ sun, 0.0, None)
    lit = np.flatnonzero(direct > 0.0)
    # Shadow rays start off the surface by more than float32 errs at that distance.
    start = points[lit] + unit[lit] * (1e-3 + 1e-4 * nearest[met[lit], None])
    toward = np.broadcast_to(sun, start.shape)
    for surface in surfaces:
        if len(lit):
            shaded = surface.blocks(start, toward)
            direct[lit[shaded]] = 0.0
            lit, start, toward = lit[~shaded], start[~shaded], toward[~shaded]
    light = _AMBIENT * (0.7 + 0.3 * unit[:, 2]) + (1.0 - _AMBIENT) * 1.3 * direct
    colour[met] = albedo * light[:, None]
    colour *= strength
    if visibility_m is not None:
        clear = np.exp(-_EXTINCTION / visibility_m * nearest)[:, None]
        colour = clear * colour + (1.0 - clear) * 0.9 * _HORIZON * strength
    # Displays want about the square root of the light.
    return np.clip(colour, 0.0, 1.0) ** (1.0 / 1.6)


def sun_of(hdri: str, yaw_deg: float) -> Float[np.ndarray, "3"]:
    """A direction for the sun that differs between HDRIs and turns with them; where theirs is, is not known here."""
    azimuth = 2.0 * math.pi * _hash(hdri) + math.radians(yaw_deg)
    flat = math.cos(_SUN_ELEVATION)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(_SUN_ELEVATION)])


def paint_of(vehicle: str) -> Float[np.ndarray, "3"]:
    """A colour for a vehicle, the same in all pictures: between olive and sand."""
    share = _hash(vehicle)
    return (1.0 - share) * np.array([0.30, 0.36, 0.17]) + share * np.array([0.66, 0.52, 0.30])


def _hash(name: str) -> float:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big") / 2**32


def _normals(mesh: Mesh, face: np.ndarray) -> Float[np.ndarray, "n 3"]:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[face]], 1, 0)
    return np.cross(b - a, c - a)
