"""Scenes of many copies of few meshes: rays are transformed into each copy's frame.

A hierarchy is built once per unique mesh, in its own frame; ten thousand copies of a tree cost one tree and ten
thousand small matrices. Embree's own instancing is out of embreex's reach, so the upper level is `geometry.boxtree`,
in float64.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.geometry.arrays import checked_array
from hulldown.geometry.boxtree import BoxTree
from hulldown.geometry.indices import rank_batches
from hulldown.geometry.meshes import Mesh, unit_normals
from hulldown.geometry.transforms import invert_affine, transform_points
from hulldown.scene.cutouts import make_caster
from hulldown.scene.ray_caster import RayCaster, RayHits, checked_rays

RAYS_PER_BLOCK = 1 << 16  # rays whose crossings are in memory at a time
# Ratio of least to largest stretch below which an instance has no inverse that keeps float32 rays apart.
MIN_DETERMINANT_SHARE = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class InstanceHits(RayHits):
    """What n rays met first; distances are in the world, and faces those of the instance's own mesh."""

    instance: Int[np.ndarray, " n"]  # index of the instance; -1 on a miss

    @classmethod
    def missed(cls, n: int) -> InstanceHits:
        """Hits for n rays that met nothing."""
        return cls(np.full(n, np.inf), np.full(n, -1, dtype=np.int32), np.full(n, -1, dtype=np.int64))


class InstancedScene:
    """Instances of meshes in the world, for two-sided ray casts. Immutable.

    `meshes`: the unique meshes, each in its own frame.
    `instance_mesh`: for each instance the index into `meshes`; k = 0 is legal.
    `world_from_instance`: affine poses: may mirror, shear and scale unevenly. A flattened instance works too, but
    becomes a mesh of its own, which is in the world.
    """

    def __init__(self, meshes: Sequence[Mesh], instance_mesh: ArrayLike, world_from_instance: ArrayLike) -> None:
        poses = np.asarray(world_from_instance, dtype=np.float64)
        poses = checked_array(poses.reshape(0, 4, 4) if not poses.size else poses, "world_from_instance", ("k", 4, 4))
        which = np.asarray(instance_mesh)
        which = checked_array(
            which if which.size else which.astype(int), "instance_mesh", (len(poses),), dtype=np.int64
        )
        if len(which) and (which.min() < 0 or which.max() >= len(meshes)):
            raise ValueError(f"instance_mesh: expected indices below {len(meshes)}, got {which.min()} to {which.max()}")
        if (poses[:, 3] != [0.0, 0.0, 0.0, 1.0]).any():
            raise ValueError("world_from_instance: expected last rows (0, 0, 0, 1)")
        self.bounds = _instance_bounds(meshes, which, poses)
        every, self.instance_mesh, self.world_from_instance = list(meshes), which.copy(), poses.copy()
        stretch = np.linalg.svd(poses[:, :3, :3], compute_uv=False)
        for i in np.flatnonzero(stretch[:, 2] <= MIN_DETERMINANT_SHARE * stretch[:, 0]):
            mesh = meshes[which[i]]
            self.instance_mesh[i] = len(every)
            every.append(mesh.with_vertices(transform_points(poses[i], mesh.vertices)))
            self.world_from_instance[i] = np.eye(4)
        self.meshes = tuple(every)
        self.instance_from_world = invert_affine(self.world_from_instance)
        self._casters = {i: make_caster(self.meshes[i]) for i in np.unique(self.instance_mesh).tolist()}
        self._tree = BoxTree(_pad_bounds(self.bounds))

    def cast(self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf) -> InstanceHits:
        """Return the first face along each ray; arguments as for `RayCaster.cast`."""
        start, along, limit = checked_rays(origins, directions, max_distance)
        hits, reach = InstanceHits.missed(len(start)), limit.copy()
        for begin in range(0, len(start), RAYS_PER_BLOCK):
            ray, instance, entry = self._crossing_pairs(start, along, reach, slice(begin, begin + RAYS_PER_BLOCK))
            for batch in rank_batches(ray):
                on = batch[entry[batch] <= reach[ray[batch]]]
                self.cast_pairs(start, along, ray[on], instance=instance[on], reach=reach, hits=hits)
        return hits

    def occluded(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf
    ) -> Bool[np.ndarray, " n"]:
        """Return whether anything lies along each ray; arguments as for `RayCaster.cast`."""
        start, along, reach = checked_rays(origins, directions, max_distance)
        blocked = np.zeros(len(start), dtype=bool)
        for begin in range(0, len(start), RAYS_PER_BLOCK):
            ray, instance, _ = self._crossing_pairs(start, along, reach, slice(begin, begin + RAYS_PER_BLOCK))
            self.occlude_pairs(start, along, ray, instance=instance, hidden=blocked, reach=reach)
        return blocked

    def normals(self, instance: Int[np.ndarray, " n"], face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return unit normals, in the world, of faces of instances' own meshes; nan for faces without area there."""
        triangles = np.empty((len(face), 3, 3))
        which = self.instance_mesh[instance]
        for mesh in np.unique(which):
            of_mesh = which == mesh
            triangles[of_mesh] = self.meshes[mesh].vertices[self.meshes[mesh].faces[face[of_mesh]]]
        turned = self.world_from_instance[instance, :3, :3]
        return unit_normals(np.einsum("nij,nkj->nki", turned, triangles))

    def overlapping_pairs(
        self, low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Return all pairs of a query's box (low to high, in the world) and an instance whose bounds touch it."""
        return self._tree.overlapping_pairs(low, high)

    def transmittance_pairs(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        ray: Int[np.ndarray, " p"],
        *,
        instance: Int[np.ndarray, " p"],
        max_distance: ArrayLike = np.inf,
    ) -> Float[np.ndarray, " n"]:
        """Return each ray's transmittance through the instances that it's paired with."""
        start, along, reach = checked_rays(origins, directions, max_distance)
        passed = np.ones(len(start))
        for caster, rows, inside, inward, scale in self._mesh_rays(start, along, ray, instance):
            through = caster.transmittance(inside, inward, max_distance=reach[ray[rows]] * scale)
            np.multiply.at(passed, ray[rows], through)
        return passed

    def cast_pairs(
        self,
        start: Float[np.ndarray, "n 3"],
        along: Float[np.ndarray, "n 3"],
        ray: Int[np.ndarray, " p"],
        *,
        instance: Int[np.ndarray, " p"],
        reach: Float[np.ndarray, " n"],
        hits: InstanceHits,
    ) -> None:
        """Let rays meet the instances that they're paired with."""
        distance, face = np.full(len(ray), np.inf), np.full(len(ray), -1, dtype=np.int32)
        for caster, rows, inside, inward, scale in self._mesh_rays(start, along, ray, instance):
            met = caster.cast(inside, inward, max_distance=reach[ray[rows]] * scale)
            distance[rows], face[rows] = met.distance / scale, met.face
        # The nearest of each ray; of equals, the instance that comes first.
        nearer = np.flatnonzero(distance < hits.distance[ray])
        order = nearer[np.lexsort((instance[nearer], distance[nearer], ray[nearer]))]
        first = order[np.diff(ray[order], prepend=-1) > 0]
        at = ray[first]
        reach[at] = hits.distance[at] = distance[first]
        hits.face[at], hits.instance[at] = face[first], instance[first]

    def occlude_pairs(
        self,
        start: Float[np.ndarray, "n 3"],
        along: Float[np.ndarray, "n 3"],
        ray: Int[np.ndarray, " p"],
        *,
        instance: Int[np.ndarray, " p"],
        hidden: Bool[np.ndarray, " n"],
        reach: Float[np.ndarray, " n"] | None = None,
    ) -> None:
        """Let instances hide what lies within `reach` along the rays that they're paired with."""
        for batch in rank_batches(ray, growth=4):
            on = batch[~hidden[ray[batch]]]
            for caster, rows, inside, inward, scale in self._mesh_rays(start, along, ray[on], instance[on]):
                rows = on[rows]
                far = np.inf if reach is None else reach[ray[rows]] * scale
                hidden[ray[rows[caster.occluded(inside, inward, max_distance=far)]]] = True

    def _crossing_pairs(
        self, start: np.ndarray, along: np.ndarray, reach: np.ndarray, part: slice
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Pairs of some rays and instances whose boxes these cross, by ray, nearest first; and where rays enter."""
        ray, box, entry = self._tree.crossed_boxes(start[part], along[part], reach[part])
        order = np.lexsort((box, entry, ray))
        return part.start + ray[order], box[order], entry[order]

    def _mesh_rays(
        self, start: np.ndarray, along: np.ndarray, ray: np.ndarray, instance: np.ndarray
    ) -> Iterator[tuple[RayCaster, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """For each mesh met: its caster, which pairs meet it, and their rays in the mesh's frame, with the stretch."""
        which = self.instance_mesh[instance]
        order = np.argsort(which, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(which[order])) + 1):
            if not len(rows):
                continue
            moves = self.instance_from_world[instance[rows]]
            inside = np.einsum("kij,kj->ki", moves[:, :3, :3], start[ray[rows]]) + moves[:, :3, 3]
            inward = np.einsum("kij,kj->ki", moves[:, :3, :3], along[ray[rows]])
            yield self._casters[which[rows[0]]], rows, inside, inward, np.sqrt((inward**2).sum(axis=1))


def _instance_bounds(
    meshes: Sequence[Mesh], instance_mesh: Int[np.ndarray, " k"], poses: Float[np.ndarray, "k 4 4"]
) -> Float[np.ndarray, "k 2 3"]:
    """Tight world boxes of all instances, from the few points of each mesh that can be extreme."""
    bounds = np.empty((len(poses), 2, 3))
    for mesh in np.unique(instance_mesh):
        x, y, z = meshes[mesh].vertices[meshes[mesh].extreme_vertices()].T.copy()
        of_mesh = np.flatnonzero(instance_mesh == mesh)
        block = max(1, (1 << 18) // len(x))
        for batch in (of_mesh[i : i + block] for i in range(0, len(of_mesh), block)):
            for axis in range(3):
                a, b, c, shift = poses[batch, axis].T[..., None]
                moved = a * x + b * y + c * z + shift
                bounds[batch, :, axis] = np.stack([moved.min(axis=1), moved.max(axis=1)], axis=1)
    return bounds


def _pad_bounds(bounds: Float[np.ndarray, "k 2 3"]) -> Float[np.ndarray, "k 2 3"]:
    """Grow boxes so that the float32 meshes stay inside."""
    pad = 1e-6 * np.ptp(bounds, axis=1) + 1e-14 * np.abs(bounds).max(axis=1) + 1e-12
    pad = pad.max(axis=1, keepdims=True)[:, None]
    return bounds + pad * np.array([-1.0, 1.0])[:, None]
