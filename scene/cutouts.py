"""Rays against meshes with alpha textures, which let rays through holes.

A texture makes most faces wholly opaque or wholly clear. The opaque ones are traced as any mesh, the clear ones are
left out; only rays that pass the opaque ones are stepped through the mixed ones, face by face, with a lookup at each.
A ray that goes on starts beyond its hit by a few units in the last place of the coordinates that Embree sees.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.geometry.alpha import HIT_OPACITY, Cut, TexelCounts
from hulldown.geometry.meshes import Mesh
from hulldown.scene.ray_caster import RayCaster, RayHits, checked_rays

STEP_ULPS = 4  # from a hit to the next start
MIN_STEP_COSINE = 1e-3  # to a face's normal; below it the step no longer grows
MIN_TRANSMITTANCE = 1e-3  # a ray with less counts as blocked
MIN_PLANE_COSINE = 1e-4  # from here on a hit is where the ray meets the face's plane in float64


def make_ray_caster(mesh: Mesh) -> RayCaster:
    """Return a ray caster for a mesh; one without holes is as fast as `RayCaster`."""
    if mesh.cutouts is None:
        return RayCaster(mesh)
    cuts = mesh.cutouts.face_cuts()
    return RayCaster(mesh) if (cuts == Cut.OPAQUE).all() else CutoutCaster(mesh, cuts)


class CutoutCaster(RayCaster):
    """Casts rays against one mesh with holes. Built once, never changes.

    A point at least `HIT_OPACITY` opaque is hit, for `cast` and `occluded`; `transmittance` multiplies what faces let
    through, as Cycles does. The topmost face under a point is that of the mesh without holes.
    """

    def __init__(self, mesh: Mesh, cuts: np.ndarray) -> None:
        assert mesh.cutouts is not None
        super().__init__(mesh)
        whole = np.ones(len(mesh.faces), dtype=bool)
        whole[mesh.cutouts.face[cuts != Cut.OPAQUE]] = False
        self._opaque_face = np.flatnonzero(whole)
        self._opaque = RayCaster(mesh.take_mesh_faces(self._opaque_face)) if len(self._opaque_face) else None
        self._mixed_face = mesh.cutouts.face[cuts == Cut.MIXED]
        self._mixed: RayCaster | None = None
        if len(self._mixed_face):
            mixed = mesh.take_mesh_faces(self._mixed_face)
            self._mixed, self._texture = RayCaster(mixed), _Textured(mixed)
            low, high = mixed.bounds
            # As RayCaster centers it, which gives the size of what float32 cannot tell apart.
            self._step = STEP_ULPS * float(np.spacing(np.float32(0.5 * np.linalg.norm(high - low))))

    def cast(self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf) -> RayHits:
        """Return the first face along each ray that hides where it's met; arguments are as for `RayCaster.cast`."""
        start, along, reach = checked_rays(origins, directions, max_distance)
        distance, face = np.full(len(start), np.inf), np.full(len(start), -1, dtype=np.int32)
        if self._opaque is not None:
            met = self._opaque.cast(start, along, max_distance=reach)
            distance, face = met.distance, np.where(met.hit, self._opaque_face[met.face], -1).astype(np.int32)
        left, at, mixed = self._trace_mixed_faces(start, along, np.minimum(reach, distance), hard=True)
        stopped = np.flatnonzero(left == 0.0)
        distance[stopped], face[stopped] = at[stopped], self._mixed_face[mixed[stopped]]
        return RayHits(distance, face)

    def occluded(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf
    ) -> Bool[np.ndarray, " n"]:
        """Return whether anything that hides blocks each ray; arguments as for `RayCaster.cast`."""
        return self._transmittance_along_rays(origins, directions, max_distance, hard=True) == 0.0

    def transmittance(
        self, origins: ArrayLike, directions: ArrayLike, *, max_distance: ArrayLike = np.inf
    ) -> Float[np.ndarray, " n"]:
        """Return the share of light along each ray that gets through; arguments are as for `RayCaster.cast`."""
        return self._transmittance_along_rays(origins, directions, max_distance, hard=False)

    def _transmittance_along_rays(
        self, origins: ArrayLike, directions: ArrayLike, max_distance: ArrayLike, *, hard: bool
    ) -> Float[np.ndarray, " n"]:
        start, along, reach = checked_rays(origins, directions, max_distance)
        left = np.ones(len(start))
        if self._opaque is not None:
            left[self._opaque.occluded(start, along, max_distance=reach)] = 0.0
        free = np.flatnonzero(left)
        left[free] = self._trace_mixed_faces(start[free], along[free], reach[free], hard=hard)[0]
        return left

    def _trace_mixed_faces(
        self, start: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"], reach: Float[np.ndarray, " n"], *, hard: bool
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Return the light that mixed faces leave on rays of unit direction, and their last hits' distance and face."""
        n = len(start)
        left, distance, hit = np.ones(n), np.full(n, np.inf), np.full(n, -1)
        if self._mixed is None:
            return left, distance, hit
        rays, from_start, last = np.arange(n), np.zeros(n), np.full(n, -1)
        more = np.ones(n)  # of the usual step beyond a hit
        while len(rays):
            origins, onward = start[rays] + from_start[rays, None] * along[rays], along[rays]
            met = self._mixed.cast(origins, onward, max_distance=reach[rays] - from_start[rays])
            on = np.flatnonzero(met.hit)
            rays, face = rays[on], met.face[on]
            at = from_start[rays] + met.distance[on]
            again = face == last[rays]
            opacity, step = self._hit_opacity_and_step(face, start[rays], along[rays], at)
            if hard:
                opacity = (opacity >= HIT_OPACITY).astype(np.float64)
            opacity[again] = 0.0
            share = left[rays] * (1.0 - opacity)
            share[share < MIN_TRANSMITTANCE] = 0.0
            left[rays], distance[rays], hit[rays] = share, at, face
            more[rays] = np.where(again, 2.0 * more[rays], 1.0)
            from_start[rays], last[rays] = at + more[rays] * step, face
            rays = rays[share > 0.0]
        return left, distance, hit

    def _hit_opacity_and_step(
        self,
        face: Int[np.ndarray, " k"],
        start: Float[np.ndarray, "k 3"],
        along: Float[np.ndarray, "k 3"],
        at: Float[np.ndarray, " k"],
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """Return mixed faces' opacity where rays meet them, and how far beyond rays can't meet the same point."""
        texture = self._texture
        normal, off = texture.normal[face], start - texture.first[face]
        facing = _row_dot(normal, along)
        steep = np.abs(facing) > MIN_PLANE_COSINE
        on_plane = -_row_dot(normal, off) / np.where(steep, facing, 1.0)
        uv = texture.uv(face, off + np.where(steep, on_plane, at)[:, None] * along)
        uv = np.clip(uv, texture.low[face], texture.high[face])
        maps = texture.cutouts.maps
        if len(maps) == 1:
            opacity = maps[0].opacity(uv).astype(np.float64)
        else:
            opacity, which = np.empty(len(face)), texture.cutouts.face_map[face]
            for number in np.unique(which):
                of_map = which == number
                opacity[of_map] = maps[number].opacity(uv[of_map])
        return opacity, self._step / np.maximum(np.abs(facing), MIN_STEP_COSINE)


class _Textured:
    """Texture coordinates on faces in float64, linear in the point of a face's plane."""

    def __init__(self, mesh: Mesh) -> None:
        assert mesh.cutouts is not None
        self.cutouts, triangles = mesh.cutouts, mesh.triangles
        self.first = triangles[:, 0]
        a, b = triangles[:, 1] - self.first, triangles[:, 2] - self.first
        normal = np.cross(a, b)
        area = (normal * normal).sum(axis=1)
        flat = area == 0.0
        area[flat] = 1.0
        gradient = np.stack([np.cross(b, normal), np.cross(normal, a)], axis=1) / area[:, None, None]
        gradient[flat] = 0.0
        corners = self.cutouts.uv.astype(np.float64)
        across = corners[:, 1:] - corners[:, :1]
        self.normal = normal / np.sqrt(area)[:, None]
        self._uv_first = corners[:, 0]
        self.gradient = (across[:, :, :, None] * gradient[:, :, None, :]).sum(axis=1)
        self.low, self.high = corners.min(axis=1), corners.max(axis=1)

    def uv(self, face: Int[np.ndarray, " k"], off: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
        """Return texture coordinates at points relative to the faces' first corners, on their planes or off them."""
        u, v = self.gradient[face].swapaxes(0, 1)
        return self._uv_first[face] + np.stack([_row_dot(u, off), _row_dot(v, off)], axis=1)


class Solidity:
    """Finds out whether the part of a face inside a box is opaque anywhere. Immutable."""

    def __init__(self, mesh: Mesh) -> None:
        cutouts = mesh.cutouts
        assert cutouts is not None
        self._place = np.full(len(mesh.faces), -1)
        self._place[cutouts.face] = np.arange(len(cutouts.face))
        self._texture = _Textured(mesh.take_mesh_faces(cutouts.face))
        self._hiding = [TexelCounts(alpha, lambda opacity: opacity >= HIT_OPACITY) for alpha in cutouts.maps]

    def maybe_solid_mask(
        self, face: Int[np.ndarray, " p"], middle: Float[np.ndarray, "p 3"], half_sides: Float[np.ndarray, "p 3 3"]
    ) -> Bool[np.ndarray, " p"]:
        """Return whether a face may reach `HIT_OPACITY` somewhere in a box; true for faces without a texture.

        `middle`, `half_sides`: middles and (p, 3, 3) halves of the three sides, as columns, of the boxes, in the
        mesh's frame.
        """
        place = self._place[face]
        solid = place < 0
        asked = np.flatnonzero(~solid)
        cut = place[asked]
        at = self._texture.uv(cut, middle[asked] - self._texture.first[cut])
        around = np.abs(np.einsum("pij,pjk->pik", self._texture.gradient[cut], half_sides[asked])).sum(axis=2)
        low = np.clip(at - around, self._texture.low[cut], self._texture.high[cut])
        high = np.clip(at + around, self._texture.low[cut], self._texture.high[cut])
        for number, hiding in enumerate(self._hiding):
            of_map = self._texture.cutouts.face_map[cut] == number
            solid[asked[of_map]] = hiding.count(low[of_map], high[of_map])[0] > 0
        return solid


def _row_dot(a: Float[np.ndarray, "k 3"], b: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]
