"""Rays against a triangle mesh: the only module that uses embreex and float32.

Undocumented behavior of Embree and embreex, and how it is handled: coordinates are float32, so a mesh is traced
about its own center, and rays that come from afar start where they enter its bounding sphere; `dists` is overwritten,
so it is always a fresh array; distances count in lengths of the direction, so directions are made unit; a miss has
primID -1 and tfar 1e37; ray batches in spatial order run several times as fast as in random order; run() releases the
GIL, building does not, and a mesh added after the first run() is ignored; about 1,000 devices crash the process, so
all scenes share one.
"""

from __future__ import annotations

import functools
import math
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Float32, Int
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.geometry.meshes import Mesh

_UNLIMITED_DISTANCE = np.float32(1e37)  # embreex's value for no limit
RAYS_PER_BLOCK = 1 << 16  # large enough to be coherent once sorted, small enough to stay in cache
_MIN_SORTED_RAYS = 4096
_MAX_COORDINATE = 1e30  # squares stay inside float64, and centered coordinates inside float32


@dataclass(frozen=True, eq=False, slots=True)
class RayHits:
    """The first hits of n rays."""

    distance: Float[np.ndarray, " n"]  # meters from the origin; inf on a miss
    face: Int[np.ndarray, " n"]  # index of the face; -1 on a miss

    @classmethod
    def all_missed(cls, n: int) -> RayHits:
        """Return the hits of n rays that met nothing."""
        return cls(np.full(n, np.inf), np.full(n, -1, dtype=np.int32))

    @property
    def hit(self) -> Bool[np.ndarray, " n"]:
        """Whether each ray met anything."""
        return self.face >= 0


class RayCaster:
    """Casts rays against one mesh, from both sides.

    Answers are those of float32 arithmetic about the mesh's own center. An origin on a surface may or may not hit
    that surface: start a little off it.
    """

    def __init__(self, mesh: Mesh) -> None:
        low, high = checked_mesh_bounds(mesh)
        self._center = 0.5 * (low + high)
        self._radius = 0.5 * math.sqrt(sum(side * side for side in (high - low).tolist()))
        self._top = np.float32((high - self._center)[2])
        self.mesh = mesh
        self._built: EmbreeScene | None = None
        self._building = threading.Lock()

    @property
    def _embree_scene(self) -> EmbreeScene:
        if self._built is None:
            with self._building:
                if self._built is None:
                    scene = EmbreeScene(_process_device(os.getpid()), robust=True)
                    with np.errstate(over="ignore"):  # vertices without a face may be huge
                        vertices = (self.mesh.vertices - self._center).astype(np.float32)
                    TriangleMesh(scene, vertices, self.mesh.faces)
                    # Builds the BVH now; afterwards the scene is only read, from any number of threads.
                    scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
                    self._built = scene
        return self._built

    def cast(self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf) -> RayHits:
        """Return the first face along each ray in the mesh's frame, within `max_distance` in meters."""
        start, unit, limit = checked_rays(origins, directions, max_distance)
        hits = RayHits.all_missed(len(start))
        for i, entry, along, reach, skipped in self._ray_blocks(start, unit, limit):
            met = self._embree_scene.run(entry, along, dists=reach.copy(), output=True)
            within = (met["primID"] >= 0) & (reach >= 0)
            hits.face[i[within]] = met["primID"][within]
            hits.distance[i[within]] = skipped[within] + met["tfar"][within]
        return hits

    def occluded(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf
    ) -> Bool[np.ndarray, " n"]:
        """Return whether anything blocks each ray; arguments as for `cast`."""
        start, unit, limit = checked_rays(origins, directions, max_distance)
        blocked = np.zeros(len(start), dtype=bool)
        for i, entry, along, reach, _ in self._ray_blocks(start, unit, limit):
            met = self._embree_scene.run(entry, along, dists=reach.copy(), query="OCCLUDED")
            blocked[i] = (met >= 0) & (reach >= 0)
        return blocked

    def transmittance(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf
    ) -> Float[np.ndarray, " n"]:
        """Return 0 where anything blocks a ray, else 1; arguments are as for `cast`."""
        return 1.0 - self.occluded(origins, directions, max_distance=max_distance)

    def normals(self, face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return unit normals of these faces, by their winding; nan for faces without area."""
        return self.mesh.normals(face)

    def top_face(self, x: Float[np.ndarray, " k"], y: Float[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
        """Return the topmost face under each point, or -1, in float32; without checks, sorting, and threads."""
        return self._embree_scene.run(self._origins_above_mesh(x, y), _DOWN_DIRECTION)

    def first_face_below(
        self, x: Float[np.ndarray, " k"], y: Float[np.ndarray, " k"], z: Float[np.ndarray, " k"]
    ) -> Int[np.ndarray, " k"]:
        """Return the first face under each point, at any height; arguments as for `top_face`."""
        origins = self._origins_above_mesh(x, y)
        np.subtract(z, self._center[2], out=origins[:, 2], casting="same_kind")
        return self._embree_scene.run(origins, _DOWN_DIRECTION)

    @property
    def resolution(self) -> float:
        """Twice the largest rounding error of a coordinate, in meters."""
        return float(np.spacing(np.float32(self._radius)))

    def _origins_above_mesh(self, x: Float[np.ndarray, " k"], y: Float[np.ndarray, " k"]) -> Float32[np.ndarray, "k 3"]:
        # Just above the highest vertex: the start height costs digits of the distance.
        origins = np.empty((len(x), 3), dtype=np.float32)
        with np.errstate(over="ignore"):
            np.subtract(x, self._center[0], out=origins[:, 0], casting="same_kind")
            np.subtract(y, self._center[1], out=origins[:, 1], casting="same_kind")
        origins[:, 2] = self._top + 2 * np.spacing(self._top) + np.float32(1e-3) * np.float32(self._radius)
        return origins

    def _ray_blocks(
        self, start: Float[np.ndarray, "n 3"], unit: Float[np.ndarray, "n 3"], limit: Float[np.ndarray, " n"]
    ) -> Iterator[tuple[Int[np.ndarray, " k"], np.ndarray, np.ndarray, np.ndarray, Float[np.ndarray, " k"]]]:
        """Yield indices of rays, in blocks; origins, directions, and limits for Embree; how far origins were moved."""
        relative = start - self._center
        nearest = -np.einsum("ij,ij->i", relative, unit)  # along the ray, to where it passes the center
        # No ray enters the bounding sphere before this distance, so that the start is moved there in float64.
        skipped = np.maximum(nearest - self._radius * (1 + 1e-6), 0.0)
        entry = (relative + skipped[:, None] * unit).astype(np.float32)
        along, reach = unit.astype(np.float32), np.minimum(limit - skipped, _UNLIMITED_DISTANCE).astype(np.float32)
        passing = relative if len(start) < _MIN_SORTED_RAYS else relative + np.maximum(nearest, 0.0)[:, None] * unit
        for i in coherent_index_blocks(passing):
            yield i, entry[i], along[i], reach[i], skipped[i]


@functools.cache
def _process_device(process: int) -> EmbreeDevice:
    """Return a process's only Embree device; a forked child opens its own, since threads don't survive a fork."""
    return EmbreeDevice()


def checked_rays(
    origins: ArrayLike, directions: ArrayLike, max_distance: ArrayLike
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Check the arguments of `RayCaster.cast`; return origins, unit directions, and maximum distances."""
    start = checked_array(origins, "origins", ("n", 3))
    along = checked_array(directions, "directions", (len(start), 3))
    reach = np.asarray(max_distance, dtype=np.float64)
    if reach.shape not in ((), (len(start),)):
        raise ValueError(f"max_distance: expected a number or shape ({len(start)},), got shape {reach.shape}")
    if np.isnan(reach).any():
        raise ValueError("max_distance: expected meters, got nan")
    length = np.sqrt(np.einsum("ij,ij->i", along, along))
    if not length.all():
        raise ValueError(f"directions: expected lengths above zero, got a zero at index {int(np.argmin(length))}")
    return start, along / length[:, None], np.broadcast_to(reach, length.shape)


def checked_mesh_bounds(mesh: Mesh) -> Float[np.ndarray, "2 3"]:
    """Return the mesh's bounds; raise ValueError if its coordinates are too large to compute with."""
    bounds = mesh.bounds
    if np.abs(bounds).max() > _MAX_COORDINATE:
        raise ValueError(f"mesh {mesh.name!r}: expected coordinates within 1e30 m, got bounds {bounds.tolist()}")
    return bounds


_DOWN_DIRECTION = np.array([[0, 0, -1]], dtype=np.float32)


def coherent_index_blocks(points: Float[np.ndarray, "n d"]) -> Iterator[Int[np.ndarray, " k"]]:
    """Yield indices of points in blocks along a Morton curve over the two widest axes, by 16-bit keys (radix sort)."""
    n = len(points)
    if n < _MIN_SORTED_RAYS:
        yield np.arange(n)
        return
    key = np.zeros(n, dtype=np.uint16)
    with np.errstate(over="ignore", invalid="ignore"):  # overflow costs only the order
        low = np.array([column.min() for column in points.T])
        extent = np.array([column.max() for column in points.T]) - low
        for shift, axis in enumerate(np.sort(np.argsort(extent)[-2:])):
            if extent[axis] > 0:
                cell = points[:, axis] - low[axis]
                cell *= 255.0 / extent[axis]
                bits = cell.astype(np.uint8).astype(np.uint16)
                for apart, kept in ((4, 0x0F0F), (2, 0x3333), (1, 0x5555)):
                    bits = (bits | bits << apart) & kept  # until each bit is followed by a zero
                key |= bits << shift
    order = np.argsort(key, kind="stable")
    yield from (order[i : i + RAYS_PER_BLOCK] for i in range(0, n, RAYS_PER_BLOCK))
