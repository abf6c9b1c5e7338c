"""A scene for ray casts: ground, obstacles, and posed vehicles together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy.typing import ArrayLike

from hulldown.assets.scenery import Scenery
from hulldown.camera.camera_rays import CameraRays
from hulldown.camera.cameras import NEAR_M, Cameras
from hulldown.geometry.columns import put_rows
from hulldown.scene.beams import nearest_in_beams, passed_in_beams
from hulldown.scene.cutouts import make_caster
from hulldown.scene.instances import InstancedScene, InstanceHits
from hulldown.scene.posed_vehicle import BATCH_RAYS, PosedVehicle
from hulldown.scene.ray_caster import RayCaster, RayHits

TILE_PX = 64  # pixels, each way, that are traced together


class Kind(IntEnum):
    """Kind of surface that a ray hits."""

    NOTHING = 0
    GROUND = 1
    OBSTACLE = 2
    VEHICLE = 3


@dataclass(frozen=True, slots=True)
class Plane:
    """An infinite level ground of one face, for sceneries without ground."""

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
        """Return whether the plane lies along each ray."""
        return self.cast(origins, directions, max_distance=max_distance).hit

    def transmittance(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf
    ) -> Float[np.ndarray, " n"]:
        """0 where the plane lies along a ray, else 1."""
        return 1.0 - self.occluded(origins, directions, max_distance=max_distance)

    def normals(self, face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return (0, 0, 1) for each face."""
        return np.tile([0.0, 0.0, 1.0], (len(face), 1))


@dataclass(frozen=True, eq=False, slots=True)
class SceneHits(RayHits):
    """First hits of n rays; faces are those of the mesh of the ground, of the instance, or of the vehicle's shape."""

    kind: UInt8[np.ndarray, " n"]
    # index of the obstacle's instance or of the vehicle; 0 for the ground, -1 on a miss
    instance: Int[np.ndarray, " n"]
    part: Int[np.ndarray, " n"]  # index of the part in the vehicle's shape; -1 for other surfaces and on a miss
    # unit, on the side of the face that the ray comes from; nan on a miss and for faces without area
    normal: Float[np.ndarray, "n 3"]

    @classmethod
    def missed(cls, n: int) -> SceneHits:
        """Those of n rays that met nothing."""
        face, instance, part = np.full((3, n), -1)
        return cls(np.full(n, np.inf), face, np.zeros(n, np.uint8), instance, part, np.full((n, 3), np.nan))


Thing: TypeAlias = RayCaster | Plane | InstancedScene | PosedVehicle
NO_OBSTACLES = InstancedScene([], [], [])


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """Ground, obstacles, and vehicles; each is optional.

    >>> import numpy as np
    >>> world = Scene(ground=Plane(0.0))
    >>> hits = world.nearest([[0.0, 0.0, 2.0]], [[0.0, 0.0, -1.0]])
    >>> float(hits.distance[0]), Kind(hits.kind[0]).name
    (2.0, 'GROUND')
    """

    ground: RayCaster | Plane | None = None  # a mesh, or the endless plane
    obstacles: InstancedScene = NO_OBSTACLES  # everything but ground and vehicles
    vehicles: Sequence[PosedVehicle] = ()  # each in one pose, or in several for the rays of different cameras

    @classmethod
    def of(cls, scenery: Scenery, *, fallback_z: float | None = None) -> Scene:
        """Return a scenery without vehicles; missing ground is the plane `fallback_z` of the file's frame, if given."""
        ground: RayCaster | Plane | None = None
        if scenery.ground is not None:
            ground = make_caster(scenery.ground)
        elif fallback_z is not None:
            ground = Plane(fallback_z - float(scenery.origin[2]))
        return cls(ground, InstancedScene(scenery.obstacle_meshes, scenery.instance_mesh, scenery.world_from_instance))

    def with_vehicles(self, vehicles: Sequence[PosedVehicle]) -> Scene:
        """Return the same ground and obstacles with these vehicles."""
        return replace(self, vehicles=vehicles)

    def take(self, cameras: Int[np.ndarray, " k"]) -> Scene:
        """Select cameras, which become cameras 0, 1, ..."""
        return self.with_vehicles([vehicle.take(cameras) for vehicle in self.vehicles])

    def nearest(self, origins: ArrayLike, directions: ArrayLike) -> SceneHits:
        """First hit of each ray; on ties ground, then obstacles, then vehicles. Arguments as for `occluded`."""
        start, along = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        return self._merge_hits(along, lambda thing, reach: thing.cast(start, along, max_distance=reach))

    def trace_image(self, camera: Cameras, *, threads: int = 1) -> SceneHits:
        """First hit at the center of each pixel of a camera, row by row; (n,) is (height * width,).

        As `nearest` for rays from the near plane on, with distances from the camera's position; faster in a wood,
        since the pixels of a tile go down the tree of instances together.

        `threads`: how many threads share the work.
        """
        width, height = camera.lenses.width, camera.lenses.height
        hits = SceneHits.missed(width * height)
        # Beyond the picture's last row and column, tiles repeat them.
        rows, columns = (
            np.arange(-(-n // TILE_PX) * TILE_PX).clip(max=n - 1).reshape(-1, TILE_PX) for n in (height, width)
        )

        def trace(band: Int[np.ndarray, " t"]) -> None:
            pixel = (band[:, None] * width + columns[:, None, :]).reshape(-1, TILE_PX * TILE_PX)
            at = camera.lenses.at_unit_depth(np.stack([pixel % width, pixel // width], axis=-1) + 0.5)
            u, v = np.ascontiguousarray(np.moveaxis(at, -1, 0))  # NumPy takes extremes along it many times faster
            low = np.stack([u.min(axis=1), v.min(axis=1)], axis=1)
            extent = np.maximum(np.stack([u.max(axis=1), v.max(axis=1)], axis=1) - low, 1e-300)
            rays = CameraRays(low, extent, (at - low[:, None]) / extent[:, None])
            put_rows(
                hits, pixel.ravel(), self._trace_cameras(rays, np.tile(camera.world_from_camera, (len(low), 1, 1)))
            )
            hits.distance[pixel] += NEAR_M * np.sqrt(1.0 + u * u + v * v)

        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(trace, rows))
        return hits

    def _trace_cameras(self, camera_rays: CameraRays, world_from_camera: Float[np.ndarray, "n 4 4"]) -> SceneHits:
        """First hits of all rays of n cameras, from the near plane on."""
        start, along = camera_rays.rays(world_from_camera, np.arange(len(world_from_camera) * camera_rays.count))

        def cast(thing: Thing, reach: Float[np.ndarray, " n"]) -> RayHits:
            match thing:
                case InstancedScene():
                    return nearest_in_beams(thing, camera_rays, world_from_camera, reach=reach)
                case PosedVehicle():
                    return thing.first_hits(camera_rays, world_from_camera, np.ones(len(reach), dtype=bool))
            return thing.cast(start, along, max_distance=reach)

        return self._merge_hits(along, cast)

    def _merge_hits(
        self,
        along: Float[np.ndarray, "n 3"],
        cast: Callable[[Thing, Float[np.ndarray, " n"]], RayHits],
    ) -> SceneHits:
        """Return the nearest hit of several casts, each within the distance of the hits before."""
        hits = SceneHits.missed(len(along))
        for kind, i, thing in self._ray_targets():
            met = cast(thing, hits.distance)
            closer = np.flatnonzero(met.distance < hits.distance)
            face = met.face[closer]
            hits.distance[closer], hits.kind[closer], hits.face[closer] = met.distance[closer], kind, face
            if isinstance(met, InstanceHits):
                assert isinstance(thing, InstancedScene)
                hits.instance[closer] = met.instance[closer]
                hits.normal[closer] = thing.normals(met.instance[closer], face)
            else:
                assert not isinstance(thing, InstancedScene)
                hits.instance[closer], hits.normal[closer] = i, thing.normals(face)
            if isinstance(thing, PosedVehicle):
                hits.part[closer] = thing.caster.face_part[face]
        hits.normal[np.einsum("ij,ij->i", hits.normal, along) > 0.0] *= -1.0
        return hits

    def occluded(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        row: Int[np.ndarray, " n"] | None = None,
        max_distance: ArrayLike = np.inf,
    ) -> Bool[np.ndarray, " n"]:
        """Return whether anything lies along each ray.

        `origins`: meters, in the world.
        `row`: ascending: the camera of each ray, which meets the vehicles of that camera. None: all are of camera 0.
        `max_distance`: how far to look, in meters; a number or (n,).
        """
        start, along = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        reach = np.broadcast_to(max_distance, len(start))
        blocked = np.zeros(len(start), dtype=bool)
        for _, _, thing in self._ray_targets():
            left = np.flatnonzero(~blocked) if blocked.any() else slice(None)
            of = {"row": None if row is None else row[left]} if isinstance(thing, PosedVehicle) else {}
            blocked[left] = thing.occluded(start[left], along[left], max_distance=reach[left], **of)
        return blocked

    def image_transmittance(
        self,
        camera_rays: CameraRays,
        world_from_camera: Float[np.ndarray, "n 4 4"],
        *,
        reach: Float[np.ndarray, " k"],
    ) -> Float[np.ndarray, " k"]:
        """Transmittance of rays of n cameras to their `reach` in meters from the near plane, -inf: not cast.

        It's 0 or 1 without alpha textures, like `occluded`, and faster among many obstacles. With them, the
        transmittances of faces are multiplied, as in Cycles.
        """
        passed, cast = np.ones(len(reach)), np.flatnonzero(reach > -np.inf)
        if self.ground is not None:
            for some in (cast[i : i + BATCH_RAYS] for i in range(0, len(cast), BATCH_RAYS)):
                rays = camera_rays.rays(world_from_camera, some)
                passed[some] = self.ground.transmittance(*rays, max_distance=reach[some])
        left = np.where(passed > 0.0, reach, -np.inf)
        passed *= passed_in_beams(self.obstacles, camera_rays, world_from_camera, reach=left)
        asked = (passed > 0.0) & (reach > -np.inf)
        for vehicle in self.vehicles:
            for part, at, rays in vehicle.part_rays(camera_rays, world_from_camera, asked):
                np.multiply.at(passed, at, part.caster.transmittance(*rays, max_distance=reach[at]))
                asked[at] = passed[at] > 0.0
        return passed

    def _ray_targets(self) -> Iterator[tuple[Kind, int, Thing]]:
        if self.ground is not None:
            yield Kind.GROUND, 0, self.ground
        yield Kind.OBSTACLE, 0, self.obstacles
        for i, vehicle in enumerate(self.vehicles):
            yield Kind.VEHICLE, i, vehicle
