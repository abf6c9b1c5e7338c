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
from hulldown.geometry.hulls import extreme_point_indices
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import compose_affine, invert_rigid
from hulldown.scene.cutouts import make_ray_caster
from hulldown.scene.ray_caster import RayCaster
from hulldown.scene.rays import Hits, LocalRayBlock, RayBatch, SurfaceKind, max_distance_per_ray

MAX_HULL_VERTICES = 64  # larger hulls are simplified


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
            _part_from_faces(int(i), shape.mesh, np.flatnonzero(face_part == i), shape.part_names[i])
            for i in np.unique(face_part)
        )

    @cached_property
    def parts_at_rest(self) -> tuple[VehiclePart, ...]:
        """The vehicle at rest as one part, which is faster for vehicles without articulation."""
        mesh = self.shape.mesh
        return self.parts if len(self.parts) == 1 else (_part_from_faces(0, mesh, np.arange(len(mesh.faces)), mesh.name),)

    def parts_with_poses(
        self,
        camera_from_vehicle: Float[np.ndarray, "n 4 4"],
        articulation: Articulation | Sequence[Articulation] | Float[np.ndarray, "n p"],
    ) -> list[tuple[VehiclePart, Float[np.ndarray, "n 4 4"]]]:
        """Return the parts to cast against, and their poses in n cameras' frames."""
        poses = self.shape.vehicle_from_parts(articulation)
        if (poses == np.eye(4)).all():
            return [(part, camera_from_vehicle) for part in self.parts_at_rest]
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

    def cameras_and_posed_parts(
        self, world_from_camera: Float[np.ndarray, "n 4 4"]
    ) -> tuple[Int[np.ndarray, " k"], list[tuple[VehiclePart, Float[np.ndarray, "k 4 4"]]]]:
        """Return the camera of each pose, and the parts to cast against with their poses in the cameras' frames."""
        row = np.arange(len(world_from_camera)) if self.row is None else self.row
        camera_from_vehicle = compose_affine(invert_rigid(world_from_camera)[row], self.world_from_vehicle)
        return row, self.caster.parts_with_poses(camera_from_vehicle, self.articulation)

    def first_hits(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Hits:
        """Return the first face of the shape's mesh along each ray, which meets the poses of its camera."""
        hits, reach = Hits.all_missed(len(rays)), max_distance_per_ray(rays, max_distance)
        for part, (at, pose, origins, directions) in self._part_ray_blocks(rays, reach > -np.inf):
            met = part.caster.cast(origins, directions, max_distance=np.minimum(reach[at], hits.distance[at]))
            # Farthest first, so that of several poses the nearest is written last.
            order = np.argsort(-met.distance, kind="stable")
            order = order[met.distance[order] < hits.distance[at[order]]]
            first = at[order]
            hits.distance[first], hits.face[first] = met.distance[order], part.face[met.face[order]]
            hits.instance[first] = np.minimum(pose[order], len(self.world_from_vehicle) - 1)  # one may be in all cameras
        hit = np.flatnonzero(hits.hit)
        hits.kind[hit], hits.part[hit] = SurfaceKind.VEHICLE, self.caster.face_part[hits.face[hit]]
        return hits

    def occlusion(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Bool[np.ndarray, " n"]:
        """Return whether the vehicle blocks each ray."""
        return self.first_hits(rays, max_distance=max_distance).hit

    def transmittance(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Float[np.ndarray, " n"]:
        """Return how much light gets through along each ray."""
        passed, reach = np.ones(len(rays)), max_distance_per_ray(rays, max_distance)
        asked = reach > -np.inf
        for part, (at, _, origins, directions) in self._part_ray_blocks(rays, asked):
            np.multiply.at(passed, at, part.caster.transmittance(origins, directions, max_distance=reach[at]))
            asked[at] = passed[at] > 0.0
        return passed

    def surface_normals(self, hits: Hits) -> Float[np.ndarray, "n 3"]:
        """Return unit normals in the world of faces that were hit; nan for faces without area."""
        shape = self.caster.shape
        parts = self.world_from_vehicle[:, None] @ shape.vehicle_from_parts(self.articulation)
        turned = parts[hits.instance, hits.part, :3, :3]
        return np.einsum("nij,nj->ni", turned, shape.mesh.normals(hits.face))

    def _part_ray_blocks(self, rays: RayBatch, asked: Bool[np.ndarray, " n"]) -> Iterator[tuple[VehiclePart, LocalRayBlock]]:
        """Yield parts, and in their frames the asked rays that may meet them; `asked` may change between blocks."""
        camera, poses = rays.cameras_and_local_poses(self.world_from_vehicle, self.row)
        for part, pose in self.caster.parts_with_poses(poses, self.articulation):
            for block in rays.local_rays_near_hull(part.around, pose, camera, asked):
                yield part, block


def bounding_points(vertices: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "c 3"]:
    """Return few points whose convex hull holds the vertices: their own hull's, or a 26-sided one's around it."""
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


def _part_from_faces(index: int, mesh: Mesh, face: Int[np.ndarray, " f"], name: str) -> VehiclePart:
    # Only the vertices that the faces use: others would move the center that rays are traced about.
    part = replace(mesh.take_mesh_faces(face), name=name)
    hull = part.vertices[extreme_point_indices(part.vertices)]
    return VehiclePart(index, make_ray_caster(part), face, hull, bounding_points(hull))
