"""Vehicles for ray casts: one ray caster per part, with rays transformed into the part's frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.spatial import HalfspaceIntersection, QhullError

from hulldown.assets.vehicle import Articulation, VehicleShape
from hulldown.camera.camera_rays import CameraRays, box_at_unit_depth
from hulldown.geometry.hulls import extreme_points
from hulldown.geometry.indices import matching_pairs
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import compose_affine, invert_rigid, rotate_vectors, transform_points
from hulldown.scene.cutouts import make_caster
from hulldown.scene.ray_caster import RayCaster, RayHits

# Rays through one pinhole are coherent as they come: batches below this size are not sorted again by RayCaster, and
# stay in cache.
BATCH_RAYS = 4095
MAX_HULL_VERTICES = 64  # hull vertices up to which the hull isn't simplified


@dataclass(frozen=True, eq=False, slots=True)
class VehiclePart:
    """One rigid part of a vehicle."""

    index: int  # its index in the shape's parts
    caster: RayCaster  # its triangles, in the vehicle frame at rest
    face: Int[np.ndarray, " f"]  # which face of the shape's mesh each of its triangles is
    hull: Float[np.ndarray, "k 3"]  # vertices of its convex hull, vehicle frame at rest
    around: Float[np.ndarray, "c 3"]  # few points whose convex hull holds the part


class VehicleCaster:
    """Casts rays against a vehicle in any pose and articulation, part by part. Immutable."""

    def __init__(self, shape: VehicleShape) -> None:
        self.shape = shape
        self.face_part = face_part = shape.vertex_part[shape.mesh.faces[:, 0]]
        self.parts = tuple(
            _make_part(int(i), shape.mesh, np.flatnonzero(face_part == i), shape.part_names[i])
            for i in np.unique(face_part)
        )

    @cached_property
    def at_rest(self) -> tuple[VehiclePart, ...]:
        """The vehicle at rest as one part, which is faster if nothing is articulated."""
        mesh = self.shape.mesh
        return self.parts if len(self.parts) == 1 else (_make_part(0, mesh, np.arange(len(mesh.faces)), mesh.name),)

    def parts_with_poses(
        self,
        camera_from_vehicle: Float[np.ndarray, "n 4 4"],
        articulation: Articulation | Sequence[Articulation] | Float[np.ndarray, "n p"],
    ) -> list[tuple[VehiclePart, Float[np.ndarray, "n 4 4"]]]:
        """Return the parts to cast against, and their poses in n cameras' frames."""
        poses = self.shape.vehicle_from_parts(articulation)
        if (poses == np.eye(4)).all():
            return [(part, camera_from_vehicle) for part in self.at_rest]
        return [(part, compose_affine(camera_from_vehicle, poses[..., part.index, :, :])) for part in self.parts]


@dataclass(frozen=True, eq=False, slots=True)
class PosedVehicle:
    """A vehicle in k poses, each for one camera: a companion that may hide a target, for example."""

    caster: VehicleCaster
    world_from_vehicle: Float[np.ndarray, "k 4 4"]
    # part name to radians, one for all poses or a sequence of k; or (k, p) angles of all parts
    articulation: Articulation | Sequence[Articulation] | Float[np.ndarray, "k p"]
    # the camera each pose belongs to. None: pose i belongs to camera i, and a single pose to all cameras.
    row: Int[np.ndarray, " k"] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.articulation, Mapping) and len(self.articulation) != len(self.world_from_vehicle):
            expected = len(self.world_from_vehicle)
            raise ValueError(f"articulation: expected one or {expected}, got {len(self.articulation)}")

    def take(self, cameras: Int[np.ndarray, " c"]) -> PosedVehicle:
        """Select cameras, which become cameras 0, 1, ..."""
        kept, row = cameras, None
        if self.row is not None:
            place = np.full(max(self.row.max(initial=0), cameras.max(initial=0)) + 1, -1)
            place[cameras] = np.arange(len(cameras))
            kept = np.flatnonzero(place[self.row] >= 0)
            row = place[self.row[kept]]
        elif len(self.world_from_vehicle) == 1:
            kept = np.zeros(1, dtype=np.int64)
        turned = self.articulation
        if isinstance(turned, np.ndarray):
            turned = turned[kept]
        elif not isinstance(turned, Mapping):
            turned = [turned[i] for i in kept.tolist()]
        return PosedVehicle(self.caster, self.world_from_vehicle[kept], turned, row)

    def parts_in_cameras(
        self, world_from_camera: Float[np.ndarray, "n 4 4"]
    ) -> tuple[Int[np.ndarray, " k"], list[tuple[VehiclePart, Float[np.ndarray, "k 4 4"]]]]:
        """Return the camera of each pose, and the parts to cast against with their poses in the cameras' frames."""
        row = np.arange(len(world_from_camera)) if self.row is None else self.row
        camera_from_vehicle = compose_affine(invert_rigid(world_from_camera)[row], self.world_from_vehicle)
        return row, self.caster.parts_with_poses(camera_from_vehicle, self.articulation)

    def cast(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        row: Int[np.ndarray, " n"] | None = None,
        max_distance: ArrayLike = np.inf,
    ) -> RayHits:
        """Return the first face of the shape's mesh along each ray in the world; arguments as for `Scene.occluded`."""
        start, along = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        reach, hits = np.broadcast_to(max_distance, len(start)), RayHits.missed(len(start))
        pose, ray = self._pose_ray_pairs(row, len(start))
        for part, world_from_part in self.caster.parts_with_poses(self.world_from_vehicle, self.articulation):
            some, rays = _sphere_pairs(part, world_from_part, pose, start[ray], along[ray])
            at = ray[some]
            met = part.caster.cast(*rays, max_distance=np.minimum(reach, hits.distance)[at])
            _keep_nearest(hits, at, met.distance, part.face[met.face])
        return hits

    def occluded(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        row: Int[np.ndarray, " n"] | None = None,
        max_distance: ArrayLike = np.inf,
    ) -> Bool[np.ndarray, " n"]:
        """Return whether the vehicle lies along each ray in the world; arguments as for `cast`."""
        return self.cast(origins, directions, row=row, max_distance=max_distance).hit

    def first_hits(
        self,
        camera_rays: CameraRays,
        world_from_camera: Float[np.ndarray, "n 4 4"],
        asked: Bool[np.ndarray, " k"],
    ) -> RayHits:
        """Return the first face of the shape's mesh along each of n cameras' rays that is asked for."""
        hits = RayHits.missed(len(asked))
        for part, at, rays in self.part_rays(camera_rays, world_from_camera, asked):
            met = part.caster.cast(*rays)
            _keep_nearest(hits, at, met.distance, part.face[met.face])
        return hits

    def part_rays(
        self,
        camera_rays: CameraRays,
        world_from_camera: Float[np.ndarray, "n 4 4"],
        asked: Bool[np.ndarray, " k"],
    ) -> Iterator[tuple[VehiclePart, Int[np.ndarray, " q"], tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, "q 3"]]]]:
        """For each part, in batches, the asked rays of n cameras that may meet it, and these in the part's frame.

        `asked` may change between batches.
        """
        camera, parts = self.parts_in_cameras(world_from_camera)
        for part, camera_from_part in parts:
            pose, ray = camera_rays.rays_through_boxes(
                box_at_unit_depth(transform_points(camera_from_part, part.around)), camera
            )
            part_from_camera = invert_rigid(camera_from_part)
            kept = np.flatnonzero(asked[camera[pose] * camera_rays.count + ray])
            for i in range(0, len(kept), BATCH_RAYS):
                some = pose[kept[i : i + BATCH_RAYS]], ray[kept[i : i + BATCH_RAYS]]
                rays = camera_rays.rays(part_from_camera, some[0] * camera_rays.count + some[1], camera)
                yield part, camera[some[0]] * camera_rays.count + some[1], rays

    def normals(self, face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return unit normals in the world of faces of the shape's mesh in the one pose; nan for faces without area."""
        shape = self.caster.shape
        parts = self.world_from_vehicle[0] @ shape.vehicle_from_parts(self.articulation)
        part_of_face = parts.reshape(-1, 4, 4)[self.caster.face_part[face], :3, :3]
        return np.einsum("nij,nj->ni", part_of_face, shape.mesh.normals(face))

    def _pose_ray_pairs(
        self, row: Int[np.ndarray, " n"] | None, rays: int
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Return all pairs of a pose and a ray of the same camera."""
        k = len(self.world_from_vehicle)
        if row is None or self.row is None:
            if k != 1 and self.row is None:
                raise ValueError(f"vehicle: expected one pose, or the row of each, got {k}")
            row = np.zeros(rays, dtype=np.int64)
        return matching_pairs(np.zeros(1, dtype=np.int64) if self.row is None else self.row, row)


def _keep_nearest(
    hits: RayHits, at: Int[np.ndarray, " q"], distance: Float[np.ndarray, " q"], face: Int[np.ndarray, " q"]
) -> None:
    """Update hits by others of the rays `at`."""
    order = np.argsort(-distance, kind="stable")  # farthest first, so that of several poses the nearest is written last
    order = order[distance[order] < hits.distance[at[order]]]
    hits.distance[at[order]], hits.face[at[order]] = distance[order], face[order]


def _sphere_pairs(
    part: VehiclePart,
    world_from_part: Float[np.ndarray, "k 4 4"],
    pose: Int[np.ndarray, " p"],
    start: Float[np.ndarray, "p 3"],
    along: Float[np.ndarray, "p 3"],
) -> tuple[Int[np.ndarray, " q"], tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, "q 3"]]]:
    """Pairs of pose and ray that cross a sphere around a part, and their rays in the part's frame."""
    low, high = part.hull.min(axis=0), part.hull.max(axis=0)
    to_center = transform_points(world_from_part, (low + high)[None] / 2)[:, 0][pose] - start
    away = np.einsum("ij,ij->i", to_center, to_center)
    ahead = np.einsum("ij,ij->i", to_center, along)
    room = 1.00001 * ((high - low) ** 2).sum() / 4 + 1e-12 * away
    aside = (away - room) * np.einsum("ij,ij->i", along, along) <= ahead**2
    some = np.flatnonzero((away <= room) | ((ahead > 0.0) & aside))
    part_from_world = invert_rigid(world_from_part)[pose[some]]
    inside = rotate_vectors(part_from_world[:, :3, :3], np.stack([start[some], along[some]], axis=1))
    return some, (inside[:, 0] + part_from_world[:, :3, 3], inside[:, 1])


def bounding_points(vertices: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "c 3"]:
    """Few points whose convex hull holds the vertices: their own hull, or the corners of a 26-sided one around it."""
    if len(vertices) <= MAX_HULL_VERTICES:
        return vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if not (high > low).all():
        return vertices
    normals = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), -1).reshape(-1, 3) / (high - low)
    normals = normals[np.any(normals != 0.0, axis=1)]
    # About a point inside, so that SciPy finds 0 for the products with it, however BLAS sums them up.
    middle = vertices.mean(axis=0)
    x, y, z = (vertices - middle).T
    # Relative to the box's size, and out by a rounding error or two.
    offset = np.array([(a * x + b * y + c * z).max() for a, b, c in normals]) + 1e-9
    try:
        corners = HalfspaceIntersection(np.c_[normals, -offset], np.zeros(3)).intersections
    except QhullError:
        return vertices
    return corners + middle


def _make_part(index: int, mesh: Mesh, face: Int[np.ndarray, " f"], name: str) -> VehiclePart:
    # Only the vertices that the faces use: others would move the center that rays are traced about.
    part = replace(mesh.of_faces(face), name=name)
    hull = part.vertices[extreme_points(part.vertices)]
    return VehiclePart(index, make_caster(part), face, hull, bounding_points(hull))
