"""A raster of the places where the number of sheets of the ground is proven.

Take every ground face, seen from above, counter-clockwise. N(p), the number of faces over a point p, changes only
across edges that faces have on their left more often, or less often, than on their right; where faces meet as they
should, the two cancel. So N is constant on every connected region that no such unbalanced edge touches, and one exact
count there holds for all of it.

`geometry.predicates.orientation_sign` turns every face exactly. For a point p on no edge let N(p) be the number of
faces that contain p. For a segment e between two vertices, let c(e) be the number of faces with e on their boundary
to its left minus those to its right; vertices at the same XY count as one. Call e unbalanced if c(e) isn't 0, and let
B be the union of all unbalanced segments, ends included.

Theorem. N is constant on each connected component of the plane without B.

Proof. Let p and q be points on no edge, in one component of the plane without B. The component is open, so a
polygonal path joins them inside it. The vertices and the crossings of non-collinear edges are finitely many, so the
path can avoid them and cross all other edge points transversally. N changes only where the path crosses edges. At
such a point all edges present are collinear. A face enters the count for each side that comes to lie ahead and leaves
it for each side that comes to lie behind, so N changes by the sum of plus or minus c(e), one common sign per
direction, over the edges e through the point. No such edge is unbalanced, since the path avoids B. Every term is 0,
and so is the change. ∎

The mesh may be disconnected, folded, self-intersecting, and of mixed winding. An edge that finds no partner, say at a
T-junction, stays in B and its cells stay unknown: slower, not wrong.

From components to cells. The raster's column of a coordinate x is `(x - low) * scale`, truncated and clipped. Every
step is monotone under round-to-nearest, so cells are products of intervals, and a coordinate between two others has a
column between theirs. Hence:

- An edge touches only cells of the rectangle spanned by its ends' cells. A short unbalanced edge marks this
  rectangle. A long one is cut into pieces first. The cuts are rounded by a few ulp, while a cell is at least 1024 ulp
  wide, and each piece marks one cell more on every side. So every cell that B touches is marked.
- An unmarked cell is convex and free of B, and the union of two unmarked cells that share a side is a rectangle free
  of B. So a 4-connected region of unmarked cells is in one component, and one exact count at a point on no edge gives
  N for all of it. Points are taken strictly inside every face that contains them. If three attempts find no such
  point, the region is unknown. Counts above `MAX_TRACED_SHEETS` are all the same.

Sheets. Let N = k around a cell, and let p in the cell be strictly inside k different faces. If another face's closed
projection contained p, points of its interior would be arbitrarily close to p, all inside the k faces as well, and
there N would be above k. (p has a neighborhood free of B, since B is closed and p isn't in it; the neighborhood meets
the cell's component.) So these are all faces over p, and the highest of them is the top. With k = 0 this means that
there is no face, and the answer is a miss. Outside the bounds the same follows from comparing coordinates.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

from hulldown.base.indices import group_and_rank
from hulldown.geometry.meshes import first_equal_indices

UNKNOWN_COUNT = 255
MAX_TRACED_SHEETS = 16  # more aren't worth tracing one after the other
_MIN_CELLS, _MAX_CELLS = 1 << 14, 1 << 22
_MAX_EDGE_PIECES = 1 << 21
_MAX_REGIONS = 1 << 12

# For each point, how many faces contain it, and whether it lies strictly inside every one of them.
CountSheets = Callable[[Float[np.ndarray, " n"], Float[np.ndarray, " n"]], tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]]


class SheetMap:
    """The number of sheets over each cell of a raster over the ground, or `UNKNOWN_COUNT`."""

    def __init__(
        self,
        vertices: Float[np.ndarray, "v 3"],
        corners: Int[np.ndarray, "3 f"],
        bounds: Float[np.ndarray, "2 2"],
        count: CountSheets,
    ) -> None:
        self._low, self._high = bounds
        extent = self._high - self._low
        # About four cells a face, as square as they come, and always far wider than a rounding error.
        side = np.sqrt(extent).prod() / np.sqrt(np.clip(4 * corners.shape[1], _MIN_CELLS, _MAX_CELLS))
        finest = 1024.0 * np.spacing(np.abs(bounds).max(axis=0))
        shape = np.clip(extent / np.maximum(side, finest), 1, 4096).astype(int)
        self.shape = self._columns, self._rows = int(shape[0]), int(shape[1])
        self._per_meter = np.minimum(shape / extent, 1e300)
        xy = vertices[:, :2]
        self._counts = self._count_sheets_by_cell(self._touched_cell_mask(xy[_unbalanced_edges(corners, xy)]), count).ravel()

    def count(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> UInt8[np.ndarray, " n"]:
        """Return the number of sheets at each point, or `UNKNOWN_COUNT`; 0 outside the bounds."""
        column, row = self.cells(x, 0), self.cells(y, 1)
        row *= self._columns
        row += column
        count = self._counts[row]
        inside = (x >= self._low[0]) & (x <= self._high[0]) & (y >= self._low[1]) & (y <= self._high[1])
        return count * inside

    def cells(self, values: Float[np.ndarray, "..."], axis: int) -> Int[np.ndarray, "..."]:
        """Return the columns (axis 0) or rows (axis 1) of coordinates."""
        # Monotone in each coordinate: what lies between two points lies in a cell between theirs.
        cell = (values - self._low[axis]) * self._per_meter[axis]
        return np.clip(cell, 0, self.shape[axis] - 1, out=cell).astype(np.intp)

    def cell_coordinates(self, cells: Float[np.ndarray, " n"], axis: int) -> Float[np.ndarray, " n"]:
        """Return the coordinates of columns or rows, fractions included."""
        return self._low[axis] + cells / self._per_meter[axis]

    def _count_sheets_by_cell(self, touched: Bool[np.ndarray, "r c"], count: CountSheets) -> UInt8[np.ndarray, "r c"]:
        regions, n = ndimage.label(~touched)
        counts = np.full(n + 1, UNKNOWN_COUNT, dtype=np.uint8)
        if n:
            size = np.bincount(regions.ravel(), minlength=n + 1)
            size[0] = 0
            largest = np.argsort(-size, kind="stable")[: min(n, _MAX_REGIONS)]
            cells = np.flatnonzero(regions)
            by_region = cells[np.argsort(regions.ravel()[cells], kind="stable")]
            first = np.cumsum(size) - size
            # The counting point must lie on no edge: try a few.
            for share in (0.5, 0.31, 0.83):
                open_ = largest[counts[largest] == UNKNOWN_COUNT]
                if not len(open_):
                    break
                row, column = np.divmod(by_region[first[open_] + (share * size[open_]).astype(int)], self._columns)
                at = np.stack([self.cell_coordinates(column + 0.5119, 0), self.cell_coordinates(row + 0.4877, 1)], axis=1)
                same = (self.cells(at[:, 0].copy(), 0) == column) & (self.cells(at[:, 1].copy(), 1) == row)
                sheets, strictly = count(at[:, 0].copy(), at[:, 1].copy())
                known = same & strictly
                counts[open_[known]] = np.minimum(sheets[known], MAX_TRACED_SHEETS + 1)
        return counts[regions]

    def _touched_cell_mask(self, edges: Float[np.ndarray, "e 2 2"]) -> Bool[np.ndarray, "r c"]:
        ends = np.stack([self.cells(edges[:, :, 0], 0), self.cells(edges[:, :, 1], 1)], axis=2)
        span = np.ptp(ends, axis=1).max(axis=1)
        short = span <= 1
        pieces = np.minimum(span[~short], max(_MAX_EDGE_PIECES // max(len(edges), 1), 1))
        long, step = group_and_rank(pieces)
        edge = np.flatnonzero(~short)[long]
        start, along = edges[edge, 0], edges[edge, 1] - edges[edge, 0]
        share = (1.0 / pieces)[long, None]
        from_, to = start + along * (step[:, None] * share), start + along * ((step[:, None] + 1) * share)
        # Points along an edge are rounded, by far less than a cell: one cell more on every side makes up for it.
        cuts = [np.stack([self.cells(p[:, 0], 0), self.cells(p[:, 1], 1)], axis=1) for p in (from_, to)]
        low = np.concatenate([ends[short].min(axis=1), np.minimum(*cuts) - 1])
        high = np.concatenate([ends[short].max(axis=1), np.maximum(*cuts) + 1])
        last = np.array([self._columns, self._rows]) - 1
        low, high = np.clip(low, 0, last), np.clip(high, 0, last) + 1
        # Rectangles as corners of a second difference, summed up.
        change = np.zeros((self._rows + 1) * (self._columns + 1), dtype=np.int32)
        for x, y, sign in ((low, low, 1), (high, high, 1), (low, high, -1), (high, low, -1)):
            np.add.at(change, y[:, 1] * (self._columns + 1) + x[:, 0], np.int32(sign))
        change = change.reshape(self._rows + 1, self._columns + 1)
        np.cumsum(change, axis=0, out=change)
        np.cumsum(change, axis=1, out=change)
        return change[:-1, :-1] > 0


def _unbalanced_edges(corners: Int[np.ndarray, "3 f"], xy: Float[np.ndarray, "v 2"]) -> Int[np.ndarray, "e 2"]:
    """Return the edges, as pairs of vertices, with more faces on their left than on their right, or fewer."""
    keys = np.empty(corners.shape, dtype=np.int64)
    for key, (i, j) in zip(keys, ((0, 1), (1, 2), (2, 0)), strict=True):
        _edge_keys(corners[i], corners[j], len(xy), out=key)
    keys = keys.ravel()
    keys.sort()
    # Most edges are settled so, without a look at coordinates; others may cancel edges with ends at the same places.
    edges, balance = _uncanceled_edges_and_sums(keys, None, len(xy))
    used, local = np.unique(edges, return_inverse=True)
    a, b = used[first_equal_indices(xy[used])][local].reshape(-1, 2).T
    keys = _edge_keys(a, b, len(xy), out=np.empty(len(edges), dtype=np.int64))
    order = np.argsort(keys)
    return _uncanceled_edges_and_sums(keys[order], balance[order], len(xy))[0]


def _edge_keys(
    a: Int[np.ndarray, " e"], b: Int[np.ndarray, " e"], n: int, *, out: Int[np.ndarray, " e"]
) -> Int[np.ndarray, " e"]:
    # (lower, higher, direction) as one integer; sorted, an edge lies beside its opposite.
    np.minimum(a, b, out=out)
    out *= n
    out += np.maximum(a, b)
    out <<= 1
    out |= a > b
    return out


def _uncanceled_edges_and_sums(
    keys: Int[np.ndarray, " e"], weights: Int[np.ndarray, " e"] | None, n: int
) -> tuple[Int[np.ndarray, "k 2"], Int[np.ndarray, " k"]]:
    """Return the edges (of sorted keys) whose weights don't cancel, directed so that remaining sums are positive."""
    if not len(keys):
        return np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64)
    edge = keys >> 1
    starts = np.flatnonzero(np.concatenate([[True], edge[1:] != edge[:-1]]))
    signed = 1 - 2 * (keys & 1).astype(np.int8)
    balance = np.add.reduceat(signed if weights is None else signed * weights, starts, dtype=np.int64)
    open_ = balance != 0
    pair = np.stack(np.divmod(edge[starts[open_]], n), axis=1)
    balance = balance[open_]
    return np.where((balance > 0)[:, None], pair, pair[:, ::-1]), np.abs(balance)
