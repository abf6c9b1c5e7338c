"""The exact top of the ground at any point, from every face that may lie under it.

Of the faces that contain a point, those with the same corners under it (a shared edge or vertex) are equally high, and
the lowest index represents them. Sheets that differ by more than the error of both are ordered in float64, the rest by
cross-multiplied integers, so equal heights of different triangulations tie exactly. A face that is known to contain a
point spares those whose boxes or planes are certainly lower there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Int8, Shaped

from hulldown.geometry.boxtree import BoxTree
from hulldown.geometry.meshes import first_equal_indices
from hulldown.geometry.predicates import exact_height_fractions as exact_height_fractions
from hulldown.geometry.predicates import exact_upward_normals as exact_upward_normals
from hulldown.geometry.predicates import orientation_sign
from hulldown.placement.ground_faces import GroundFaceHits, GroundFaces, upward_normals

_POINTS_PER_BLOCK = 1 << 11  # intermediate arrays stay in cache


@dataclass(frozen=True, eq=False, slots=True)
class _Over:
    """Pairs of a point and a face that contains it, by point; `sides` has the corners with a share in the point."""

    point: Int[np.ndarray, " k"]
    face: Int[np.ndarray, " k"]
    sides: Int8[np.ndarray, "k 3"]

    def __getitem__(self, which: Shaped[np.ndarray, " m"]) -> _Over:
        return _Over(self.point[which], self.face[which], self.sides[which])


class ExactGround:
    """Top hits in exact arithmetic wherever float64 can't decide; slower than Embree, and correct on every input."""

    def __init__(self, ground: GroundFaces, low: Float[np.ndarray, "3 f"], high: Float[np.ndarray, "3 f"]) -> None:
        self._ground = ground
        self._boxes = BoxTree(np.stack([low.T, high.T], axis=1))

    def count(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
    ) -> tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Return how many faces contain each point, and whether it is strictly inside all of them."""
        faces, on_edge = np.zeros(len(x), dtype=np.intp), np.zeros(len(x), dtype=bool)
        for batch, over in self._containing_face_batches(x, y, np.full(len(x), -np.inf)):
            n = batch.stop - batch.start
            faces[batch] = np.bincount(over.point, minlength=n)
            on_edge[batch] = np.bincount(over.point[(over.sides == 0).any(axis=1)], minlength=n) > 0
        return faces, ~on_edge

    def top_hits(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], proposal: Int[np.ndarray, " n"]
    ) -> GroundFaceHits:
        """Return the highest ground face at each point, of ties the lowest; `proposal`: faces that may be it, or -1."""
        n = len(x)
        tops = GroundFaceHits(np.full(n, np.nan), np.full((n, 3), np.nan), np.full(n, -1, np.int32))
        for batch, over in self._containing_face_batches(x, y, self._least_top_heights(x, y, proposal)):
            here = x[batch], y[batch]
            over = self._highest_pairs(here, over)
            row = over.point + batch.start
            tops.face[row] = over.face
            tops.z[row] = self._face_heights_at_points(here, over)
            tops.normal[row] = self._face_normals(over.face)
        return tops

    def _least_top_heights(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], proposal: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        g = self._ground
        least = np.full(len(x), -np.inf)
        row = np.flatnonzero(proposal >= 0)
        over = self._inside_pairs(x, y, row, proposal[row])
        least[over.point] = g.height_bounds(over.face, x[over.point], y[over.point])[0]
        return least

    def _containing_face_batches(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], least: Float[np.ndarray, " n"]
    ) -> Iterator[tuple[slice, _Over]]:
        """Yield batches of points, with the faces that contain them and may be as high as `least` there."""
        g = self._ground
        for begin in range(0, len(x), _POINTS_PER_BLOCK):
            batch = slice(begin, min(begin + _POINTS_PER_BLOCK, len(x)))
            low = np.stack([x[batch], y[batch], least[batch]], axis=1)
            high = np.stack([x[batch], y[batch], np.full(len(low), np.inf)], axis=1)
            point, face = self._boxes.overlapping_pairs(low, high)
            if len(face) > 2 * len(low):  # else looking at heights doesn't pay
                _, highest = g.height_bounds(face, low[point, 0], low[point, 1])
                kept = np.flatnonzero(highest >= low[point, 2])
                point, face = point[kept], face[kept]
            over = self._inside_pairs(x[batch], y[batch], point, face)
            yield batch, over[np.lexsort((over.face, over.point))]

    def _inside_pairs(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], point: Int[np.ndarray, " k"], face: Int[np.ndarray, " k"]
    ) -> _Over:
        g = self._ground
        over = _Over(point, face, np.empty((len(point), 3), dtype=np.int8))
        for i in range(3):
            a, b = g.corners[(i + 1) % 3][over.face], g.corners[(i + 2) % 3][over.face]
            over.sides[:, i] = orientation_sign(g.x[a], g.y[a], g.x[b], g.y[b], x[over.point], y[over.point])
            over = over[np.flatnonzero(over.sides[:, i] >= 0)]
        return over

    def _highest_pairs(self, at: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], over: _Over) -> _Over:
        alone = _sole_pair_mask(over.point)
        rest = over[np.flatnonzero(~alone)]
        if not len(rest.point):
            return over
        # Faces that meet in the very edge or vertex under the point are equally high: only the lowest is kept.
        rest = _drop_equal_pairs(rest, np.where(rest.sides > 0, self._ground.corners[:, rest.face].T, -1))
        rest = self._pairs_maybe_highest(at, rest)
        # The same for sheets that coincide, with vertices of their own.
        rest = _drop_equal_pairs(
            rest, np.where(rest.sides > 0, self._first_coincident_vertices(self._ground.corners[:, rest.face].T), -1)
        )
        done = [over[np.flatnonzero(alone)]]
        alone = _sole_pair_mask(rest.point)
        done.append(rest[np.flatnonzero(alone)])
        rest = rest[np.flatnonzero(~alone)]
        if len(rest.point):
            done.append(self._highest_pairs_by_integers(at, rest))
        return _Over(*(np.concatenate([getattr(d, f) for d in done]) for f in ("point", "face", "sides")))

    def _pairs_maybe_highest(self, at: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], over: _Over) -> _Over:
        low, high = self._ground.height_bounds(over.face, at[0][over.point], at[1][over.point])
        starts = np.flatnonzero(np.concatenate([[True], over.point[1:] != over.point[:-1]]))
        bar = np.repeat(np.maximum.reduceat(low, starts), np.diff(np.append(starts, len(low))))
        return over[np.flatnonzero(high >= bar)]

    def _highest_pairs_by_integers(self, at: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], over: _Over) -> _Over:
        numerator, denominator = exact_height_fractions(self._face_corners(over.face), at[0][over.point], at[1][over.point])
        best: dict[int, int] = {}
        # Faces come in rising order, and only a higher one replaces: ties stay with the lowest face.
        for i, p in enumerate(over.point.tolist()):
            j = best.setdefault(p, i)
            if numerator[i] * denominator[j] > numerator[j] * denominator[i]:
                best[p] = i
        return over[np.fromiter(best.values(), dtype=np.intp, count=len(best))]

    def _face_heights_at_points(
        self, at: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], over: _Over
    ) -> Float[np.ndarray, " k"]:
        g = self._ground
        x, y = at[0][over.point], at[1][over.point]
        z = g.heights(over.face, x, y)
        ill_conditioned = np.flatnonzero(~g.well_conditioned[over.face])
        if len(ill_conditioned):
            numerator, denominator = exact_height_fractions(
                self._face_corners(over.face[ill_conditioned]), x[ill_conditioned], y[ill_conditioned]
            )
            z[ill_conditioned] = (numerator / denominator).astype(np.float64)
        return z

    def _face_normals(self, face: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
        normal = upward_normals(self._ground.slope[face])
        ill_conditioned = np.flatnonzero(~self._ground.well_conditioned[face])
        if len(ill_conditioned):
            normal[ill_conditioned] = exact_upward_normals(self._face_corners(face[ill_conditioned]))
        return normal

    def _first_coincident_vertices(self, vertices: Int[np.ndarray, "k 3"]) -> Int[np.ndarray, "k 3"]:
        g = self._ground
        used, local = np.unique(vertices, return_inverse=True)
        places = np.column_stack([g.x[used], g.y[used], g.z[used]])
        return used[first_equal_indices(places)][local].reshape(vertices.shape)

    def _face_corners(self, face: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k 3 3"]:
        vertex = self._ground.corners[:, face].T
        return np.stack([self._ground.x[vertex], self._ground.y[vertex], self._ground.z[vertex]], axis=2)


def _sole_pair_mask(point: Int[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    changes = np.concatenate([[True], point[1:] != point[:-1], [True]]) if len(point) else np.ones(1, dtype=bool)
    return changes[:-1] & changes[1:]


def _drop_equal_pairs(over: _Over, support: Int[np.ndarray, "k 3"]) -> _Over:
    """Return of the pairs with the same point and the same corners under it the one with the lowest face; in order."""
    support = np.sort(support, axis=1)
    order = np.lexsort((over.face, *support.T, over.point))
    key = np.column_stack([over.point, support])[order]
    first = np.concatenate([[True], (key[1:] != key[:-1]).any(axis=1)])
    return over[np.sort(order[first])]
