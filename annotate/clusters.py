"""The box of a clipped surface by branch and bound: only triangles that can widen it are clipped."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from hulldown.annotate.clipping import EMPTY, extremes_of_mesh, extremes_of_points, union
from hulldown.annotate.curves import CurvedView, extremes_of_curved
from hulldown.annotate.posing import PosedParts, move, slices
from hulldown.camera.frustum import Frustum
from hulldown.camera.projection import NEAR
from hulldown.geometry.transforms import BOX_CORNERS

SMALL = 30_000  # triangles: clipping up to so many takes less time than choosing among them
LEAF = 64  # triangles in a cluster: fewer cost more bounds, more cost more clipping
ROUND = 4  # clusters looked at for each side at first; twice as many in every round that follows
SLACK = 1e-12  # of a cluster's distance and size: what bounds may be off by their rounding


class ClusteredSurface:
    """A vehicle's triangles in compact clusters with boxes around them."""

    def __init__(self, parts: PosedParts) -> None:
        self._parts = parts

    @cached_property
    def _clusters(self) -> _Clusters:
        return _Clusters(self._parts)

    def extremes(self, camera_from_parts: Float[np.ndarray, "p 3 4"], frustum: Frustum) -> Float[np.ndarray, "4"]:
        """Return lowest u, lowest v, highest u, highest v of the surface inside the frustum; empty if there is none.

        The hull's vertices that are inside give a first box. A cluster can widen it on one side only if the box
        around the cluster reaches beyond the plane through the camera and that side.
        """
        parts = self._parts
        first = move(parts.extreme, parts.extreme_slices, camera_from_parts[None])[:, 0]
        outside = frustum.outside(first)
        best = extremes_of_points(frustum.project(first[:, outside == 0]))
        if np.bitwise_and.reduce(outside) or (not frustum.frame and not outside.any()):
            return best
        if len(parts.faces) <= SMALL:
            points = move(parts.vertices, parts.vertex_slices, camera_from_parts[None])[:, 0]
            return extremes_of_mesh(points, parts.faces, frustum)
        clusters = self._clusters
        left = clusters.within(frustum, best, camera_from_parts, np.arange(len(clusters.faces)))
        count = ROUND
        while len(left):
            chosen = np.ones(len(left), dtype=bool)
            if len(left) > 4 * count:
                # Clusters far beyond a side are likely to move it most, and so to rule out others.
                depth = clusters.reach(np.array([[0.0, 0.0, 1.0, 0.0]]), camera_from_parts, left)
                gain = clusters.gain(best, frustum, camera_from_parts, left) / np.maximum(depth, NEAR)
                chosen[:] = False
                chosen[np.argpartition(gain, -count, axis=1)[:, -count:]] = True
            best = union(best, extremes_of_mesh(*clusters.mesh(left[chosen], camera_from_parts), frustum))
            left, count = clusters.within(frustum, best, camera_from_parts, left[~chosen]), 2 * count
        return best

    def curved_extremes(
        self, camera_from_parts: Float[np.ndarray, "p 3 4"], view: CurvedView
    ) -> Float[np.ndarray, "4"]:
        """`extremes` through a distorting lens, from clusters that may reach beyond the hull's vertices."""
        first = move(self._parts.extreme, self._parts.extreme_slices, camera_from_parts[None])[:, 0]
        if (first[2] < NEAR).all():
            return EMPTY
        best = view.seen(first)
        clusters = self._clusters
        left = np.flatnonzero(view.may_widen(best, *clusters.rectangles(camera_from_parts)))
        return extremes_of_curved(*clusters.mesh(left, camera_from_parts), view, best)


class _Clusters:
    """Triangles in groups of neighbors, those of one part together, with boxes around them in the frames of parts."""

    def __init__(self, parts: PosedParts) -> None:
        self._vertices = parts.vertices
        faces = [_neighbors(parts.vertices, parts.faces[place]) for place in parts.face_slices]
        self.faces: Int[np.ndarray, "k leaf 3"] = np.concatenate(faces)
        self._ends = np.cumsum([0, *map(len, faces)])
        corners = parts.vertices[:, self.faces.reshape(len(self.faces), -1)]
        low, high = corners.min(axis=2), corners.max(axis=2)
        self._center, self._half = (low + high) / 2.0, (high - low) / 2.0
        self._size = np.abs([low, high]).max(initial=0.0)

    def mesh(
        self, which: Int[np.ndarray, " m"], camera_from_parts: Float[np.ndarray, "p 3 4"]
    ) -> tuple[Float[np.ndarray, "3 n"], Int[np.ndarray, "f 3"]]:
        """Return the triangles of some clusters in the camera's frame, which share no points."""
        corners = self._vertices[:, self.faces[which].reshape(-1)]
        ends = np.searchsorted(which, self._ends) * self.faces[0].size
        points = move(corners, slices(ends), camera_from_parts[None])[:, 0]
        return points, np.arange(points.shape[1]).reshape(-1, 3)

    def within(
        self,
        frustum: Frustum,
        best: Float[np.ndarray, "4"],
        camera_from_parts: Float[np.ndarray, "p 3 4"],
        which: Int[np.ndarray, " m"],
    ) -> Int[np.ndarray, " l"]:
        """Those of `which` that may reach into the frustum and beyond a side of the best box."""
        inside = (self.reach(frustum.planes, camera_from_parts, which) >= 0.0).all(axis=0)
        which = which[inside]
        return which[(self.gain(best, frustum, camera_from_parts, which) > 0.0).any(axis=0)]

    def gain(
        self,
        best: Float[np.ndarray, "4"],
        frustum: Frustum,
        camera_from_parts: Float[np.ndarray, "p 3 4"],
        which: Int[np.ndarray, " m"],
    ) -> Float[np.ndarray, "4 m"]:
        """At least how far what is in front of the near plane reaches beyond each side of the best box, scaled."""
        sides = frustum.beyond(best)
        reach = self.reach(sides, camera_from_parts, which)
        # Where depth takes away, the near plane is as good as it gets: this is what bounds boxes that lie across it.
        falling = sides[:, 2] < 0.0
        sides[falling, 3], sides[falling, 2] = sides[falling, 2] * NEAR, 0.0
        return np.minimum(reach, self.reach(sides, camera_from_parts, which))

    def rectangles(
        self, camera_from_parts: Float[np.ndarray, "p 3 4"]
    ) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k 2"]]:
        """Return the corners at unit depth of what holds each box; nan if it isn't all beyond the near plane."""
        boxes = self._center[:, :, None] + self._half[:, :, None] * BOX_CORNERS.T[:, None]
        x, y, z = move(boxes.reshape(3, -1), slices(8 * self._ends), camera_from_parts[None]).reshape(3, -1, 8)
        z = np.where((z >= NEAR).all(axis=1)[:, None], z, np.nan)
        at = np.stack([x / z, y / z], 2)
        room = SLACK * (1.0 + np.abs(at))  # for the rounding of both
        return (at - room).min(axis=1), (at + room).max(axis=1)

    def reach(
        self,
        functions: Float[np.ndarray, "h 4"],
        camera_from_parts: Float[np.ndarray, "p 3 4"],
        which: Int[np.ndarray, " m"],
    ) -> Float[np.ndarray, "h m"]:
        """At least the greatest value of a x + b y + c z + d, camera coordinates, in each of some boxes.

        `which` is in ascending order, so that boxes of one part lie together.
        """
        greatest = np.empty((len(functions), len(which)))
        normals, offsets = functions[:, :3], functions[:, 3]
        for pose, place in zip(camera_from_parts, slices(np.searchsorted(which, self._ends)), strict=True):
            turned, apart = normals @ pose[:, :3], normals @ pose[:, 3] + offsets
            rounding = np.abs(normals) @ (self._size + np.abs(pose[:, 3])) + np.abs(offsets)
            # Not a matrix product: one this small and wide is handed to threads, which cost more than they save.
            greatest[:, place] = np.einsum("hj,jm->hm", turned, self._center[:, which[place]])
            greatest[:, place] += np.einsum("hj,jm->hm", np.abs(turned), self._half[:, which[place]])
            greatest[:, place] += (apart + SLACK * rounding)[:, None]
        return greatest


def _neighbors(vertices: Float[np.ndarray, "3 v"], faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "k leaf 3"]:
    """Return faces in groups of neighbors; the last group is filled up with its last face."""
    if not len(faces):
        return np.empty((0, LEAF, 3), dtype=np.int64)
    order = KDTree(vertices[:, faces].mean(axis=2).T, leafsize=LEAF).indices
    count = -(-len(faces) // LEAF)
    return faces[order[np.minimum(np.arange(count * LEAF), len(faces) - 1)]].reshape(count, LEAF, 3)
