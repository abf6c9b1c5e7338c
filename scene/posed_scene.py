"""A scene for rays: ground, obstacles, and posed vehicles together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.assets.scenery import Scenery
from hulldown.base.columns import put_rows
from hulldown.scene.cutouts import make_ray_caster
from hulldown.scene.ground import Ground, Plane
from hulldown.scene.instances import InstancedScene
from hulldown.scene.posed_vehicle import PosedVehicle
from hulldown.scene.ray_caster import RayCaster
from hulldown.scene.rays import Hits, RayBatch, RayPiece, RaySet, RayTarget, max_distance_per_ray

NO_OBSTACLES = InstancedScene([], [], [])


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """Ground, obstacles, and vehicles, each optional: a `RayTarget`.

    >>> import numpy as np
    >>> from hulldown.scene.rays import RayList, SurfaceKind
    >>> world = Scene(ground=Plane(0.0))
    >>> hits = world.first_hits(RayList([[0.0, 0.0, 2.0]], [[0.0, 0.0, -1.0]]))
    >>> float(hits.distance[0]), SurfaceKind(hits.kind[0]).name
    (2.0, 'GROUND')
    """

    ground: RayCaster | Plane | None = None  # a mesh, or the endless plane
    obstacles: InstancedScene = NO_OBSTACLES  # everything but ground and vehicles
    vehicles: Sequence[PosedVehicle] = ()  # each in one pose, or in several for the rays of different cameras

    @classmethod
    def from_scenery(cls, scenery: Scenery, *, fallback_z: float | None = None) -> Scene:
        """Return a scenery without vehicles; missing ground is the plane `fallback_z` of the file's frame, if given."""
        ground: RayCaster | Plane | None = None
        if scenery.ground is not None:
            ground = make_ray_caster(scenery.ground)
        elif fallback_z is not None:
            ground = Plane(fallback_z - float(scenery.origin[2]))
        return cls(ground, InstancedScene(scenery.obstacle_meshes, scenery.instance_mesh, scenery.world_from_instance))

    def with_vehicles(self, vehicles: Sequence[PosedVehicle]) -> Scene:
        """Return the same ground and obstacles with these vehicles."""
        return replace(self, vehicles=vehicles)

    def take(self, cameras: Int[np.ndarray, " k"]) -> Scene:
        """Select cameras, which become cameras 0, 1, ..."""
        return self.with_vehicles([vehicle.take(cameras) for vehicle in self.vehicles])

    def first_hits(self, rays: RaySet, *, max_distance: ArrayLike = np.inf, threads: int = 1) -> Hits:
        """Return each ray's first surface, with `threads` threads; on ties ground, then obstacles, then vehicles."""
        hits, reach = Hits.all_missed(len(rays)), max_distance_per_ray(rays, max_distance)

        def trace(piece: Callable[[], RayPiece]) -> None:
            ray, batch, lead = piece()
            found = self._batch_hits(batch, reach[ray] - lead)
            put_rows(hits, ray, replace(found, distance=found.distance + lead))

        if threads == 1:
            for piece in rays.ray_piece_makers():
                trace(piece)
            return hits
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(trace, rays.ray_piece_makers()))
        return hits

    def occlusion(self, rays: RaySet, *, max_distance: ArrayLike = np.inf) -> Bool[np.ndarray, " n"]:
        """Return whether anything blocks each ray."""
        hidden, reach = np.zeros(len(rays), dtype=bool), max_distance_per_ray(rays, max_distance)
        for ray, batch, lead in (piece() for piece in rays.ray_piece_makers()):
            left = reach[ray] - lead
            for _, target in self._numbered_targets():
                left[target.occlusion(batch, max_distance=left)] = -np.inf
            hidden[ray] = (left == -np.inf) & (reach[ray] > -np.inf)
        return hidden

    def transmittance(self, rays: RaySet, *, max_distance: ArrayLike = np.inf) -> Float[np.ndarray, " n"]:
        """Return the product of what faces let through along each ray, as in Cycles."""
        passed, reach = np.ones(len(rays)), max_distance_per_ray(rays, max_distance)
        for ray, batch, lead in (piece() for piece in rays.ray_piece_makers()):
            light, left = np.ones(len(batch)), reach[ray] - lead
            for _, target in self._numbered_targets():
                light *= target.transmittance(batch, max_distance=left)
                left[light == 0.0] = -np.inf
            passed[ray] = light
        return passed

    def surface_normals(self, hits: Hits) -> Float[np.ndarray, "n 3"]:
        """Return unit normals of what the rays hit."""
        return hits.normal

    def _batch_hits(self, rays: RayBatch, reach: Float[np.ndarray, " n"]) -> Hits:
        hits = Hits.all_missed(len(rays))
        for number, target in self._numbered_targets():
            found = target.first_hits(rays, max_distance=reach)
            closer = np.flatnonzero(found.distance < hits.distance)
            found = found.take(closer)
            found.normal[:] = target.surface_normals(found)
            if number is not None:
                found.instance[:] = number
            put_rows(hits, closer, found)
            reach = np.minimum(reach, hits.distance)
        hits.normal[np.einsum("ij,ij->i", hits.normal, rays.directions) > 0.0] *= -1.0
        return hits

    def _numbered_targets(self) -> Iterator[tuple[int | None, RayTarget]]:
        if self.ground is not None:
            yield None, Ground(self.ground)
        yield None, self.obstacles
        yield from enumerate(self.vehicles)
