"""Scenes of many copies of few meshes, each in one tree, found by `geometry.boxtree`: embreex has no instancing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.geometry.boxtree import BoxTree
from hulldown.geometry.meshes import Mesh, unit_normals
from hulldown.geometry.transforms import invert_affine, transform_points
from hulldown.scene.cutouts import MIN_TRANSMITTANCE, make_ray_caster
from hulldown.scene.ray_caster import RayCaster
from hulldown.scene.rays import Hits, RayBatch, SurfaceKind, max_distance_per_ray

# Ratio of least to largest stretch below which an instance has no inverse that keeps float32 rays apart.
MIN_DETERMINANT_SHARE = 1e-6


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
        which = checked_array(which if which.size else which.astype(int), "instance_mesh", (len(poses),), dtype=np.int64)
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
        self._casters = {i: make_ray_caster(self.meshes[i]) for i in np.unique(self.instance_mesh).tolist()}
        self._tree = BoxTree(_pad_bounds(self.bounds))

    def overlapping_pairs(
        self, low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Return all pairs of a query's box (low to high, in the world) and an instance whose bounds touch it."""
        return self._tree.overlapping_pairs(low, high)

    def first_hits(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Hits:
        """Return the first face along each ray; faces are those of the instance's own mesh."""
        hits, reach = Hits.all_missed(len(rays)), max_distance_per_ray(rays, max_distance)
        for ray, instance in rays.ray_instance_pairs(self._tree, self.bounds, reach):
            distance, face = np.full(len(ray), np.inf), np.full(len(ray), -1, dtype=np.int32)
            for caster, rows, inside, inward, scale in self._rays_by_mesh(rays, ray, instance):
                met = caster.cast(inside, inward, max_distance=reach[ray[rows]] * scale)
                distance[rows], face[rows] = met.distance / scale, met.face
            # The nearest of each ray; of equals, the instance that comes first.
            nearer = np.flatnonzero(distance < hits.distance[ray])
            order = nearer[np.lexsort((instance[nearer], distance[nearer], ray[nearer]))]
            first = order[np.diff(ray[order], prepend=-1) > 0]
            at = ray[first]
            reach[at] = hits.distance[at] = distance[first]
            hits.face[at], hits.instance[at] = face[first], instance[first]
        hits.kind[hits.hit] = SurfaceKind.OBSTACLE
        return hits

    def occlusion(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Bool[np.ndarray, " n"]:
        """Return whether anything blocks each ray."""
        hidden, reach = np.zeros(len(rays), dtype=bool), max_distance_per_ray(rays, max_distance)
        for ray, instance in rays.ray_instance_pairs(self._tree, self.bounds, reach):
            for caster, rows, inside, inward, scale in self._rays_by_mesh(rays, ray, instance):
                at = ray[rows]
                hidden[at[caster.occluded(inside, inward, max_distance=reach[at] * scale)]] = True
            reach[ray[hidden[ray]]] = -np.inf
        return hidden

    def transmittance(self, rays: RayBatch, *, max_distance: ArrayLike = np.inf) -> Float[np.ndarray, " n"]:
        """Return how much light gets through along each ray."""
        passed, reach = np.ones(len(rays)), max_distance_per_ray(rays, max_distance)
        for ray, instance in rays.ray_instance_pairs(self._tree, self.bounds, reach):
            at, number = np.unique(ray, return_inverse=True)
            light = np.ones(len(at))
            for caster, rows, inside, inward, scale in self._rays_by_mesh(rays, ray, instance):
                share = caster.transmittance(inside, inward, max_distance=reach[ray[rows]] * scale)
                np.multiply.at(light, number[rows], share)
            passed[at] *= light
            blocked = at[passed[at] < MIN_TRANSMITTANCE]
            passed[blocked], reach[blocked] = 0.0, -np.inf
        return passed

    def surface_normals(self, hits: Hits) -> Float[np.ndarray, "n 3"]:
        """Return unit normals, in the world, of faces that were hit; nan for faces without area there."""
        triangles = np.empty((len(hits.face), 3, 3))
        which = self.instance_mesh[hits.instance]
        for mesh in np.unique(which):
            of_mesh = which == mesh
            triangles[of_mesh] = self.meshes[mesh].vertices[self.meshes[mesh].faces[hits.face[of_mesh]]]
        turned = self.world_from_instance[hits.instance, :3, :3]
        return unit_normals(np.einsum("nij,nkj->nki", turned, triangles))

    def _rays_by_mesh(
        self, rays: RayBatch, ray: Int[np.ndarray, " p"], instance: Int[np.ndarray, " p"]
    ) -> Iterator[tuple[RayCaster, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """For each mesh met: its caster, the pairs that meet it, and their rays and stretch in the mesh's frame."""
        which = self.instance_mesh[instance]
        order = np.argsort(which, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(which[order])) + 1):
            if not len(rows):
                continue
            moves = self.instance_from_world[instance[rows]]
            inside = np.einsum("kij,kj->ki", moves[:, :3, :3], rays.origins[ray[rows]]) + moves[:, :3, 3]
            inward = np.einsum("kij,kj->ki", moves[:, :3, :3], rays.unit_directions[ray[rows]])
            yield self._casters[which[rows[0]]], rows, inside, inward, np.sqrt((inward**2).sum(axis=1))


def _instance_bounds(
    meshes: Sequence[Mesh], instance_mesh: Int[np.ndarray, " k"], poses: Float[np.ndarray, "k 4 4"]
) -> Float[np.ndarray, "k 2 3"]:
    bounds = np.empty((len(poses), 2, 3))
    for mesh in np.unique(instance_mesh):
        x, y, z = meshes[mesh].vertices[meshes[mesh].extreme_vertex_indices()].T.copy()
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
