"""Ground as a target of rays: a mesh, or an endless plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.scene.ray_caster import RayCaster, RayHits
from hulldown.scene.rays import Hits, RayBatch, SurfaceKind, max_distance_per_ray


@dataclass(frozen=True, slots=True)
class Plane:
    """Infinite level ground of one face, for sceneries without ground; it has `RayCaster`'s methods."""

    z: float

    def cast(self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf) -> RayHits:
        """Return where each ray meets the plane; arguments as for `RayCaster.cast`."""
        o, d = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (self.z - o[:, 2]) / d[:, 2] * np.linalg.norm(d, axis=1)
        met = (at > 0.0) & (at <= max_distance) & (at < np.inf)
        return RayHits(np.where(met, at, np.inf), np.where(met, 0, -1))

    def occluded(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf
    ) -> Bool[np.ndarray, " n"]:
        """Return whether the plane blocks each ray."""
        return self.cast(origins, directions, max_distance=max_distance).hit

    def transmittance(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf
    ) -> Float[np.ndarray, " n"]:
        """Return 0 where the plane blocks a ray, else 1."""
        return 1.0 - self.occluded(origins, directions, max_distance=max_distance)

    def normals(self, face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return (0, 0, 1) for each face."""
        return np.tile([0.0, 0.0, 1.0], (len(face), 1))


@dataclass(frozen=True, eq=False, slots=True)
class Ground:
    """The ground as a `RayTarget`."""

    caster: RayCaster | Plane

    def first_hits(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Hits:
        """Return the first face along each ray."""
        hits, reach = Hits.all_missed(len(rays)), max_distance_per_ray(rays, max_distance)
        for ray, start, along in rays.asked_ray_blocks(reach > -np.inf):
            met = self.caster.cast(start, along, max_distance=reach[ray])
            hits.distance[ray], hits.face[ray] = met.distance, met.face
        hits.kind[hits.hit], hits.instance[hits.hit] = SurfaceKind.GROUND, 0
        return hits

    def occlusion(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Bool[np.ndarray, " n"]:
        """Return whether the ground blocks each ray."""
        hidden, reach = np.zeros(len(rays), dtype=bool), max_distance_per_ray(rays, max_distance)
        for ray, start, along in rays.asked_ray_blocks(reach > -np.inf):
            hidden[ray] = self.caster.occluded(start, along, max_distance=reach[ray])
        return hidden

    def transmittance(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Float[np.ndarray, " n"]:
        """Return how much light gets through along each ray."""
        passed, reach = np.ones(len(rays)), max_distance_per_ray(rays, max_distance)
        for ray, start, along in rays.asked_ray_blocks(reach > -np.inf):
            passed[ray] = self.caster.transmittance(start, along, max_distance=reach[ray])
        return passed

    def surface_normals(self, hits: Hits) -> Float[np.ndarray, "n 3"]:
        """Return unit normals of faces that were hit."""
        return self.caster.normals(hits.face)
