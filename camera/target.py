"""A vehicle as rays meet it: one ray caster a part, turned by its articulation, never moved into the world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.spatial import HalfspaceIntersection, QhullError

from assets.vehicle import Articulation, VehicleShape
from geometry.cutouts import CutoutCaster, caster_of
from geometry.hulls import extreme_points
from geometry.meshes import Mesh
from geometry.rays import RayCaster, RayHits
from geometry.transforms import apply, compose, invert_rigid

FEW = 64  # hull vertices below which simplifying the hull does not pay


@dataclass(frozen=True, eq=False, slots=True)
class TargetPart:
    """One rigid part of a vehicle.

    Parameters
    ----------
    index
        Its index in the shape's parts.
    caster
        Its triangles, in the vehicle frame at rest.
    face
        (f,) which face of the shape's mesh each of its triangles is.
    hull
        (k, 3) vertices of its convex hull, vehicle frame at rest.
    around
        (c, 3) few points whose convex hull holds the part.
    """

    index: int
    caster: RayCaster | CutoutCaster
    face: Int[np.ndarray, " f"]
    hull: Float[np.ndarray, "k 3"]
    around: Float[np.ndarray, "c 3"]


class VehicleTarget:
    """Built once for a vehicle; answers which rays meet it in any pose and articulation.

    Parameters
    ----------
    shape
        The vehicle.
    """

    def __init__(self, shape: VehicleShape) -> None:
        self.shape = shape
        face_part = shape.vertex_part[shape.mesh.faces[:, 0]]
        self.parts = tuple(
            _part(int(i), shape.mesh, np.flatnonzero(face_part == i), shape.part_names[i]) for i in np.unique(face_part)
        )
        # At rest one caster for all is quicker than one a part.
        self.at_rest = (
            self.parts if len(self.parts) == 1 else (_part(0, shape.mesh, np.arange(len(face_part)), shape.mesh.name),)
        )

    def hull_points(self, articulation: Articulation) -> Float[np.ndarray, "k 3"]:
        """Vehicle-frame points with the convex hull of the articulated vehicle; any projected box is theirs."""
        poses = self.shape.vehicle_from_parts(articulation)
        return np.concatenate([apply(poses[part.index], part.hull) for part in self.parts])

    def placed(
        self, camera_from_vehicle: Float[np.ndarray, "n 4 4"], articulation: Articulation | Sequence[Articulation]
    ) -> list[tuple[TargetPart, Float[np.ndarray, "n 4 4"]]]:
        """The parts to cast against and where each is in n cameras' frames."""
        poses = self.shape.vehicle_from_parts(articulation)
        if (poses == np.eye(4)).all():
            return [(part, camera_from_vehicle) for part in self.at_rest]
        return [(part, compose(camera_from_vehicle, poses[..., part.index, :, :])) for part in self.parts]


@dataclass(frozen=True, eq=False, slots=True)
class PosedVehicle:
    """A vehicle in n poses, such as a companion that may hide the target of n cameras.

    Parameters
    ----------
    target
        The vehicle.
    world_from_vehicle
        (n, 4, 4) rigid poses, one for each camera, or (1, 4, 4) for all of them.
    articulation
        Part name to radians; one for all, or a sequence of n.
    """

    target: VehicleTarget
    world_from_vehicle: Float[np.ndarray, "n 4 4"]
    articulation: Articulation | Sequence[Articulation]

    def rows(self, index: np.ndarray) -> PosedVehicle:
        """The poses of some of the cameras."""
        poses = self.world_from_vehicle if len(self.world_from_vehicle) == 1 else self.world_from_vehicle[index]
        turned = self.articulation
        some = turned if isinstance(turned, Mapping) else [turned[int(i)] for i in index]
        return PosedVehicle(self.target, poses, some)

    def seen_from(
        self, world_from_camera: Float[np.ndarray, "n 4 4"]
    ) -> list[tuple[TargetPart, Float[np.ndarray, "n 4 4"]]]:
        """The parts to cast against and where each is in the cameras' frames."""
        camera_from_vehicle = compose(invert_rigid(world_from_camera), self.world_from_vehicle)
        return self.target.placed(camera_from_vehicle, self.articulation)

    def cast(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf, threads: int = 1
    ) -> RayHits:
        """The first face of the shape's mesh along each ray in the world; arguments as for `RayCaster.cast`.

        Raises
        ------
        ValueError
            If the vehicle has several poses.
        """
        start, along = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        reach = np.broadcast_to(max_distance, len(start))
        distance, face = np.full(len(start), np.inf), np.full(len(start), -1)
        for part, world_from_part in self._parts():
            asked = np.flatnonzero(_near(part, world_from_part, start, along))
            rays = _into(world_from_part, start[asked], along[asked])
            met = part.caster.cast(*rays, max_distance=np.minimum(reach, distance)[asked], threads=threads)
            closer = met.distance < distance[asked]
            at = asked[closer]
            distance[at], face[at] = met.distance[closer], part.face[met.face[closer]]
        return RayHits(distance, face)

    def occluded(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf, threads: int = 1
    ) -> Bool[np.ndarray, " n"]:
        """Whether the vehicle lies along each ray in the world; arguments and errors as for `cast`."""
        start, along = np.asarray(origins, dtype=np.float64), np.asarray(directions, dtype=np.float64)
        reach = np.broadcast_to(max_distance, len(start))
        blocked = np.zeros(len(start), dtype=bool)
        for part, world_from_part in self._parts():
            asked = np.flatnonzero(~blocked & _near(part, world_from_part, start, along))
            rays = _into(world_from_part, start[asked], along[asked])
            blocked[asked] = part.caster.occluded(*rays, max_distance=reach[asked], threads=threads)
        return blocked

    def normals(self, face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Unit normals, in the world, of faces of the shape's mesh; nan for faces without area."""
        shape = self.target.shape
        parts = self.world_from_vehicle[0] @ shape.vehicle_from_parts(self.articulation)
        part = shape.vertex_part[shape.mesh.faces[face, 0]]
        return np.einsum("nij,nj->ni", parts.reshape(-1, 4, 4)[part, :3, :3], shape.mesh.normals(face))

    def _parts(self) -> list[tuple[TargetPart, Float[np.ndarray, "4 4"]]]:
        if len(self.world_from_vehicle) != 1:
            raise ValueError(f"vehicle: expected one pose, got {len(self.world_from_vehicle)}")
        posed = self.target.placed(self.world_from_vehicle, self.articulation)
        return [(part, world_from_part[0]) for part, world_from_part in posed]


def _into(
    world_from_part: Float[np.ndarray, "4 4"], start: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Rays in the world as rays in a part's frame."""
    return apply(invert_rigid(world_from_part), start), along @ world_from_part[:3, :3]


def _near(
    part: TargetPart,
    world_from_part: Float[np.ndarray, "4 4"],
    start: Float[np.ndarray, "n 3"],
    along: Float[np.ndarray, "n 3"],
) -> Bool[np.ndarray, " n"]:
    """Which rays in the world may meet a part: those that cross a sphere around it, with room for rounding."""
    low, high = part.hull.min(axis=0), part.hull.max(axis=0)
    to_centre = apply(world_from_part, (low + high)[None] / 2) - start
    away = np.einsum("ij,ij->i", to_centre, to_centre)
    ahead = np.einsum("ij,ij->i", to_centre, along)
    room = 1.00001 * ((high - low) ** 2).sum() / 4 + 1e-12 * away
    aside = (away - room) * np.einsum("ij,ij->i", along, along) <= ahead**2
    return (away <= room) | ((ahead > 0.0) & aside)


def points_around(vertices: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "c 3"]:
    """Few points whose convex hull holds the vertices: their own hull, or the corners of a 26-sided one around it."""
    if len(vertices) <= FEW:
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


def _part(index: int, mesh: Mesh, face: Int[np.ndarray, " f"], name: str) -> TargetPart:
    # Only the vertices that the faces use: others would move the centre that rays are traced about.
    part = replace(mesh.of_faces(face), name=name)
    hull = part.vertices[extreme_points(part.vertices)]
    return TargetPart(index, caster_of(part), face, hull, points_around(hull))
