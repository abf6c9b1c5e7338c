"""The box of a clipped surface by branch and bound: only triangles that can still widen it are looked at."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from annotate.clipping import Frustum, extremes_of_points, extremes_of_triangles, union
from annotate.posing import PosedParts, move
from camera.projection import NEAR

LEAF = 64  # triangles in a cluster: fewer cost more bounds, more cost more clipping
ROUND = 4  # clusters looked at for each side at first; twice as many in every round that follows
SLACK = 1e-12  # of a cluster's distance and size: what bounds may be off by their rounding


class ClusteredSurface:
    """A vehicle's triangles in compact clusters with boxes around them.

    Parameters
    ----------
    parts
        The vehicle's surface.
    """

    def __init__(self, parts: PosedParts) -> None:
        self._parts = parts
        clusters = [_clusters(parts.vertices, parts.faces[place]) for place in parts.face_slices]
        self._ends = np.cumsum([0, *(len(c) for c in clusters)])
        self._faces: Int[np.ndarray, "k leaf 3"] = np.concatenate(clusters)
        corners = parts.vertices[:, self._faces.reshape(len(self._faces), -1)]
        low, high = corners.min(axis=2), corners.max(axis=2)
        self._centre: Float[np.ndarray, "3 k"] = (low + high) / 2.0
        self._half: Float[np.ndarray, "3 k"] = (high - low) / 2.0

    def extremes(self, camera_from_parts: Float[np.ndarray, "p 3 4"], frustum: Frustum) -> Float[np.ndarray, "4"]:
        """Lowest u, lowest v, highest u, highest v of the surface inside the frustum; empty if there is none.

        The hull's vertices that are inside give a first box. A cluster can widen it on one side only if the box
        around the cluster reaches beyond the plane through the camera and that side.
        """
        parts = self._parts
        first = move(parts.extreme, parts.extreme_slices, camera_from_parts[None])[:, 0]
        best = extremes_of_points(frustum.project(first[:, frustum.outside(first) == 0]))
        if not frustum.frame and np.isinf(best).any():
            return best  # a hull wholly behind the near plane
        centre = move(self._centre, _slices(self._ends), camera_from_parts[None])[:, 0]
        left = np.arange(len(self._faces))
        reach = self._reach(frustum.planes[:, :3], frustum.planes[:, 3], camera_from_parts, centre, left)
        left = left[(reach >= 0.0).all(axis=0)]
        count = ROUND
        while len(left):
            gain = self._reach(_sides(best, frustum), np.zeros(4), camera_from_parts, centre[:, left], left)
            widens = (gain > 0.0).any(axis=0)
            left, gain = left[widens], gain[:, widens]
            chosen = np.ones(len(left), dtype=bool)
            if len(left) > 4 * count:
                # What lies far beyond a side is likely to move it most, and so to rule out others.
                gain /= np.maximum(centre[2, left], NEAR)
                chosen[:] = False
                chosen[np.argpartition(gain, -count, axis=1)[:, -count:]] = True
            best = union(best, self._look(left[chosen], camera_from_parts, frustum))
            left, count = left[~chosen], 2 * count
        return best

    def _reach(
        self,
        normals: Float[np.ndarray, "h 3"],
        offsets: Float[np.ndarray, " h"],
        camera_from_parts: Float[np.ndarray, "p 3 4"],
        centre: Float[np.ndarray, "3 m"],
        clusters: Int[np.ndarray, " m"],
    ) -> Float[np.ndarray, "h m"]:
        """At least the greatest value that each linear function of camera coordinates takes in each cluster's box.

        `clusters` are in ascending order, so that those of one part lie together.
        """
        greatest = normals @ centre
        size = np.abs(normals) @ np.abs(centre)
        for part, place in enumerate(_slices(np.searchsorted(clusters, self._ends))):
            along = np.abs(normals @ camera_from_parts[part, :, :3])
            greatest[:, place] += along @ self._half[:, clusters[place]]
        return greatest + SLACK * size + offsets[:, None]

    def _look(
        self, clusters: Int[np.ndarray, " m"], camera_from_parts: Float[np.ndarray, "p 3 4"], frustum: Frustum
    ) -> Float[np.ndarray, "4"]:
        corners = self._parts.vertices[:, self._faces[clusters].reshape(-1)]
        ends = np.searchsorted(clusters, self._ends) * self._faces[0].size
        moved = move(corners, _slices(ends), camera_from_parts[None])
        return extremes_of_triangles(moved.reshape(3, -1, 3), frustum)


def _sides(best: Float[np.ndarray, "4"], frustum: Frustum) -> Float[np.ndarray, "4 3"]:
    """Linear functions that are positive, in front of the camera, at what lies beyond each side of a box.

    Zero for sides that the image's edge has closed. Of an empty box everything in the image lies beyond.
    """
    f, width, height = frustum.f_px, frustum.width, frustum.height
    if np.isinf(best).any():
        best = np.array([width, height, 0.0, 0.0])
    u0, v0, u1, v1 = best
    rows = np.array(
        [
            [-f, 0.0, u0 - width / 2.0],
            [0.0, -f, v0 - height / 2.0],
            [f, 0.0, width / 2.0 - u1],
            [0.0, f, height / 2.0 - v1],
        ]
    )
    if frustum.frame:
        rows[[u0 <= 0.0, v0 <= 0.0, u1 >= width, v1 >= height]] = 0.0
    return rows


def _clusters(vertices: Float[np.ndarray, "3 v"], faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "k leaf 3"]:
    """Faces in groups of neighbours; the last group is filled up with its last face."""
    if not len(faces):
        return np.empty((0, LEAF, 3), dtype=np.int64)
    order = KDTree(vertices[:, faces].mean(axis=2).T, leafsize=LEAF).indices
    count = -(-len(faces) // LEAF)
    return faces[order[np.minimum(np.arange(count * LEAF), len(faces) - 1)]].reshape(count, LEAF, 3)


def _slices(ends: Int[np.ndarray, " n"]) -> list[slice]:
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]
