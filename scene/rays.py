"""Rays to trace, what they hit, and the protocol of everything that they can hit."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy.typing import ArrayLike

from hulldown.base.columns import take
from hulldown.base.indices import matching_pairs, rank_batches
from hulldown.geometry.boxtree import BoxTree
from hulldown.geometry.transforms import invert_rigid, rotate_vectors, transform_points
from hulldown.scene.ray_caster import checked_rays

RAYS_PER_BLOCK = 1 << 16  # their crossings are in memory together


class SurfaceKind(IntEnum):
    """The kind of surface that a ray hits."""

    NOTHING = 0
    GROUND = 1
    OBSTACLE = 2
    VEHICLE = 3


@dataclass(frozen=True, eq=False, slots=True)
class Hits:
    """The first hits of n rays."""

    distance: Float[np.ndarray, " n"]  # meters from the ray's origin; inf on a miss
    kind: UInt8[np.ndarray, " n"]
    # index of the obstacle's instance, of the vehicle in a scene, or of the pose of a vehicle alone; 0 for the ground,
    # -1 on a miss
    instance: Int[np.ndarray, " n"]
    part: Int[np.ndarray, " n"]  # index of the part in the vehicle's shape; -1 for other surfaces and on a miss
    # in the mesh of the ground, of the instance, or of the vehicle's shape; -1 on a miss
    face: Int[np.ndarray, " n"]
    # unit, on the side of the face that the ray comes from; nan on a miss, for faces without area, and without a scene
    normal: Float[np.ndarray, "n 3"]

    @classmethod
    def all_missed(cls, n: int) -> Hits:
        """Return the hits of n rays that hit nothing."""
        instance, part, face = np.full((3, n), -1)
        return cls(np.full(n, np.inf), np.zeros(n, np.uint8), instance, part, face, np.full((n, 3), np.nan))

    @property
    def hit(self) -> Bool[np.ndarray, " n"]:
        """Whether each ray hit anything."""
        return self.face >= 0

    def take(self, rows: Int[np.ndarray, " k"]) -> Hits:
        """Return some rows."""
        return take(self, rows)


class RayBlock(NamedTuple):
    """Some rays of a batch, by index, in the world."""

    ray: Int[np.ndarray, " q"]
    origins: Float[np.ndarray, "q 3"]
    directions: Float[np.ndarray, "q 3"]


class LocalRayBlock(NamedTuple):
    """Rays of a batch that may meet something in one of its poses, in its frame."""

    ray: Int[np.ndarray, " q"]
    pose: Int[np.ndarray, " q"]
    origins: Float[np.ndarray, "q 3"]
    directions: Float[np.ndarray, "q 3"]


class RayPiece(NamedTuple):
    """Some rays of a set, by index, that are traced together."""

    ray: Int[np.ndarray, " k"]
    batch: RayBatch
    lead: Float[np.ndarray, " k"] | float  # meters from where the set's rays begin to where the batch's do


class RaySet(Protocol):
    """n rays in one or several batches."""

    def __len__(self) -> int: ...

    def ray_piece_makers(self) -> Sequence[Callable[[], RayPiece]]:
        """Return functions that make the set's batches."""
        ...


class RayBatch(ABC):
    """n rays that are traced together; a ray whose reach is -inf isn't cast."""

    @property
    @abstractmethod
    def origins(self) -> Float[np.ndarray, "n 3"]:
        """Origins in the world, meters."""

    @property
    @abstractmethod
    def directions(self) -> Float[np.ndarray, "n 3"]:
        """Directions of any length."""

    @cached_property
    def unit_directions(self) -> Float[np.ndarray, "n 3"]:
        """Unit directions."""
        return self.directions / np.sqrt(np.einsum("ij,ij->i", self.directions, self.directions))[:, None]

    def __len__(self) -> int:
        return len(self.origins)

    def ray_piece_makers(self) -> Sequence[Callable[[], RayPiece]]:
        """Return the batch alone."""
        return [lambda: RayPiece(np.arange(len(self)), self, 0.0)]

    @abstractmethod
    def asked_ray_blocks(self, asked: Bool[np.ndarray, " n"]) -> Iterator[RayBlock]:
        """Yield the asked rays in the world."""

    @abstractmethod
    def ray_instance_pairs(
        self, tree: BoxTree, bounds: Float[np.ndarray, "k 2 3"], reach: Float[np.ndarray, " n"]
    ) -> Iterator[tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]]:
        """Yield rays and instances, by the tree of their boxes, that may meet, nearest first; callers lower `reach`."""

    @abstractmethod
    def cameras_and_local_poses(
        self, world_from_vehicle: Float[np.ndarray, "k 4 4"], row: Int[np.ndarray, " k"] | None
    ) -> tuple[Int[np.ndarray, " k"] | None, Float[np.ndarray, "m 4 4"]]:
        """Return the camera of each pose, and the poses in the frames in which `local_rays_near_hull` expects them."""

    @abstractmethod
    def local_rays_near_hull(
        self,
        points: Float[np.ndarray, "c 3"],
        poses: Float[np.ndarray, "k 4 4"],
        camera: Int[np.ndarray, " k"] | None,
        asked: Bool[np.ndarray, " n"],
    ) -> Iterator[LocalRayBlock]:
        """Yield asked rays that may meet the points' hull in poses, in its frame; `asked` may change between blocks."""


class RayList(RayBatch):
    """Rays with any origins and directions.

    `origins`: meters, in the world.
    `camera`: ascending: the camera of each ray, which meets the vehicles of that camera. None: all are of camera 0.
    """

    def __init__(self, origins: ArrayLike, directions: ArrayLike, camera: Int[np.ndarray, " n"] | None = None) -> None:
        self._origins, self.unit_directions, _ = checked_rays(origins, directions, np.inf)
        self._directions, self.camera = np.asarray(directions, dtype=np.float64), camera

    @property
    def origins(self) -> Float[np.ndarray, "n 3"]:
        """Origins in the world, meters."""
        return self._origins

    @property
    def directions(self) -> Float[np.ndarray, "n 3"]:
        """Directions of any length."""
        return self._directions

    def take(self, rows: Int[np.ndarray, " k"]) -> RayList:
        """Return some of the rays, in ascending order."""
        taken = object.__new__(RayList)  # not checked again
        taken._origins, taken._directions, taken.unit_directions = (
            self.origins[rows],
            self.directions[rows],
            self.unit_directions[rows],
        )
        taken.camera = None if self.camera is None else self.camera[rows]
        return taken

    def asked_ray_blocks(self, asked: Bool[np.ndarray, " n"]) -> Iterator[RayBlock]:
        """Yield the asked rays."""
        if asked.all():
            yield RayBlock(np.arange(len(self)), self.origins, self.directions)
        else:
            rows = np.flatnonzero(asked)
            yield RayBlock(rows, self.origins[rows], self.directions[rows])

    def ray_instance_pairs(
        self, tree: BoxTree, bounds: Float[np.ndarray, "k 2 3"], reach: Float[np.ndarray, " n"]
    ) -> Iterator[tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]]:
        """Yield each ray with the instances whose boxes it crosses."""
        asked = np.flatnonzero(reach > -np.inf)
        for begin in range(0, len(asked), RAYS_PER_BLOCK):
            rows = asked[begin : begin + RAYS_PER_BLOCK]
            ray, instance, entry = tree.ray_box_crossings(self.origins[rows], self.unit_directions[rows], reach[rows])
            order = np.lexsort((instance, entry, ray))
            ray, instance, entry = rows[ray[order]], instance[order], entry[order]
            for batch in rank_batches(ray):
                on = batch[entry[batch] <= reach[ray[batch]]]
                yield ray[on], instance[on]

    def cameras_and_local_poses(
        self, world_from_vehicle: Float[np.ndarray, "k 4 4"], row: Int[np.ndarray, " k"] | None
    ) -> tuple[Int[np.ndarray, " k"] | None, Float[np.ndarray, "k 4 4"]]:
        """Return poses in the world, as they are."""
        if row is None and len(world_from_vehicle) != 1:
            raise ValueError(f"vehicle: expected one pose, or the row of each, got {len(world_from_vehicle)}")
        return row, world_from_vehicle

    def local_rays_near_hull(
        self,
        points: Float[np.ndarray, "c 3"],
        poses: Float[np.ndarray, "k 4 4"],
        camera: Int[np.ndarray, " k"] | None,
        asked: Bool[np.ndarray, " n"],
    ) -> Iterator[LocalRayBlock]:
        """Yield the rays that cross a sphere around the points."""
        own = np.zeros(len(self), dtype=np.int64) if self.camera is None or camera is None else self.camera
        pose, ray = matching_pairs(np.zeros(1, dtype=np.int64) if camera is None else camera, own)
        if not asked.all():
            pose, ray = pose[asked[ray]], ray[asked[ray]]
        start, along = self.origins[ray], self.directions[ray]
        low, high = points.min(axis=0), points.max(axis=0)
        to_center = transform_points(poses, (low + high)[None] / 2)[:, 0][pose] - start
        away = np.einsum("ij,ij->i", to_center, to_center)
        ahead = np.einsum("ij,ij->i", to_center, along)
        room = 1.00001 * ((high - low) ** 2).sum() / 4 + 1e-12 * away
        aside = (away - room) * np.einsum("ij,ij->i", along, along) <= ahead**2
        some = np.flatnonzero((away <= room) | ((ahead > 0.0) & aside))
        points_from_world = invert_rigid(poses)[pose[some]]
        inside = rotate_vectors(points_from_world[:, :3, :3], np.stack([start[some], along[some]], axis=1))
        yield LocalRayBlock(ray[some], pose[some], inside[:, 0] + points_from_world[:, :3, 3], inside[:, 1])


class RayTarget(Protocol):
    """What rays can hit: the ground, instances, a vehicle, or a scene of all of them.

    `max_distance`: how far to look from the rays' origins, in meters: a number or (n,); -inf: a ray isn't cast.
    """

    def first_hits(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Hits:
        """Return the first surface along each ray."""
        ...

    def occlusion(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Bool[np.ndarray, " n"]:
        """Return whether anything blocks each ray."""
        ...

    def transmittance(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Float[np.ndarray, " n"]:
        """Return the product of what faces let through along each ray, as in Cycles."""
        ...

    def surface_normals(self, hits: Hits) -> Float[np.ndarray, "n 3"]:
        """Return unit normals of faces that were hit, by their winding; nan for faces without area."""
        ...


def max_distance_per_ray(rays: RaySet, max_distance: ArrayLike) -> Float[np.ndarray, " n"]:
    """Return how far each ray looks, as a new array."""
    return np.array(np.broadcast_to(np.asarray(max_distance, dtype=np.float64), len(rays)))
