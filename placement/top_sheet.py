"""A raster of planes between the top sheet of the ground and all others, where these are many.

Call the height of a point over a cell's plane its residual. Faces whose boxes touch the cell are called *upper* and
*lower*, in any way. Suppose that

(1) no edge touches the cell that faces have on their left more often, or less often, than on their right; here edges
    are the same if their ends are at the same places in space;
(2) at points in the cell, residuals of lower faces are below a limit, and those of upper faces above it;
(3) one point of the cell is strictly inside one upper face, and in no other.

Theorem. If a point p of the cell is strictly inside a face f, and f's residual at p is above the limit, then every
other face over p is lower there than f.

Proof. By (2), f is an upper face, and lower faces are lower than f at p. Let U be the number of upper faces over a
point. As in `sheet_map`, U changes along a path only where the path crosses edges, by the balance that upper faces give
to each. All faces at an edge share its point over the path, so by (2) they are all upper or all lower; hence upper
faces give an edge its whole balance, or nothing, and by (1) that's 0. A cell is a product of intervals, so U is 1 on
all of it by (3). A small neighborhood of p meets no faces and edges but those over p, for which the same holds at p
itself; it meets the inside of the cell, so U is 1 there as well. If another upper face's closed projection contained p,
points of its interior would be arbitrarily close to p, inside f as well, and there U would be above 1. ∎

A face's residuals are between those of its corners. A face all of which is lower than the plane that has the guessed
second sheet's residual is a lower face without a closer look, since no limit is below that. Limits have room for the
rounding of residuals and the error of f's height.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from scipy import ndimage

from hulldown.geometry.indices import batches, numbered
from hulldown.geometry.predicates import EPS, orient
from hulldown.placement.ground import Ground
from hulldown.placement.sheet_map import SheetMap

_MOST_PAIRS = 8  # of a face and a cell that its box touches, for each face
_STEEPEST = 10.0  # slope of a plane
_WINDOW = 3  # cells: wider faces get a closer look
_FACES = 1 << 14  # looked at together

# For each point, the slope of the highest sheet, and the heights of the two highest; as good as a guess can be, or nan.
Guess = Callable[
    [Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
    tuple[Complex[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
]


class TopSheet:
    """Planes with one sheet above them and all others below, in cells of a raster.

    `error`: more than twice the error of a height in meters.
    """

    def __init__(
        self, sheets: SheetMap, ground: Ground, boxes: Float[np.ndarray, "2 3 f"], error: float, guess: Guess
    ) -> None:
        self._sheets = sheets
        ends = np.stack([sheets.cells(boxes[:, axis], axis) for axis in (0, 1)])
        self._shift = 0
        while (np.ptp(ends >> self._shift, axis=1) + 1).prod(axis=0).sum() > _MOST_PAIRS * boxes.shape[2]:
            self._shift += 1
        side = 1 << self._shift
        many = sheets.many
        for axis, n in enumerate(many.shape):
            many = np.logical_and.reduceat(many, np.arange(0, n, side), axis=axis)
        row, column = np.nonzero(many)
        x, y = (
            sheets.at((np.minimum((i + 1) * side, n) + i * side) / 2, axis)
            for axis, (i, n) in enumerate(zip((column, row), sheets.shape, strict=True))
        )
        slope, first, second = guess(x, y)
        kept = (first > second) & (np.maximum(np.abs(slope.real), np.abs(slope.imag)) < _STEEPEST)
        row, column, self._x, self._y = row[kept], column[kept], x[kept], y[kept]
        self._cell = np.full(many.shape, -1, dtype=np.int32)
        self._cell[row, column] = np.arange(len(row))
        # The mean of neighbors is nearer to how a rough sheet slopes than the one face in the middle of a cell.
        slopes = np.zeros(many.shape, dtype=np.complex128)
        slopes[row, column] = slope[kept]
        self._slope = (ndimage.uniform_filter(slopes) / ndimage.uniform_filter((self._cell >= 0) + 1e-9))[row, column]
        low, high = boxes
        reach = 2.0 * (high - low.min(axis=1)[:, None])[:2].max()
        steep = np.abs(self._slope.real) + np.abs(self._slope.imag)
        room = error + 16.0 * EPS * (np.abs(boxes[:, 2]).max() + steep * reach)
        self._limit = self._limits(ground, ends >> self._shift, high[2], (first[kept], second[kept]), room)

    def has(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], z: Float[np.ndarray, " n"]
    ) -> Bool[np.ndarray, " n"]:
        """Return whether a face that each point is strictly inside, and its height there, are certainly the highest."""
        cell = self._at(x, y)
        certain = cell >= 0
        i = np.flatnonzero(certain)
        certain[i] = self._residual(cell[i], x[i], y[i], z[i]) > self._limit[cell[i]]
        return certain

    def _at(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        return self._cell[self._sheets.cells(y, 1) >> self._shift, self._sheets.cells(x, 0) >> self._shift]

    def _residual(
        self,
        cell: Int[np.ndarray, " n"],
        x: Float[np.ndarray, "*m n"],
        y: Float[np.ndarray, "*m n"],
        z: Float[np.ndarray, "*m n"],
    ) -> Float[np.ndarray, "*m n"]:
        slope = self._slope[cell]
        return (z - slope.real * (x - self._x[cell])) - slope.imag * (y - self._y[cell])

    def _limits(
        self,
        ground: Ground,
        ends: Int[np.ndarray, "2 2 f"],
        high: Float[np.ndarray, " f"],
        levels: tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]],
        room: Float[np.ndarray, " k"],
    ) -> Float[np.ndarray, " k"]:
        """Return the limit of each cell, infinite where there is none."""
        first, second = levels
        x, y = (self._sheets.at(np.array([0.0, 0.51 * 2**self._shift]), axis) for axis in (0, 1))
        drop = np.abs(self._slope.real) * np.diff(x) + np.abs(self._slope.imag) * np.diff(y)
        floor = np.full(self._cell.shape, np.inf)
        floor[self._cell >= 0] = second - drop - room
        floor = ndimage.minimum_filter(floor, _WINDOW, mode="constant", cval=np.inf, origin=-(_WINDOW // 2))
        (left, right), (bottom, top) = ends
        wide, tall = right - left + 1, top - bottom + 1
        near = np.flatnonzero((high >= floor[bottom, left]) | (wide > _WINDOW) | (tall > _WINDOW))
        below, above, over = second.copy(), np.full(len(second), np.inf), np.zeros(len(second), dtype=np.int32)
        for batch in batches(len(near), _FACES):
            some = near[batch]
            pair, number = numbered(wide[some] * tall[some])
            face = some[pair]
            up, right_of = np.divmod(number, wide[face])
            cell = self._cell[bottom[face] + up, left[face] + right_of]
            face, cell = face[cell >= 0], cell[cell >= 0]
            x, y, z = (values[ground.corners[:, face]] for values in (ground.x, ground.y, ground.z))
            residual = self._residual(cell, x, y, z)
            lowest, highest = residual.min(axis=0), residual.max(axis=0)
            upper = lowest + highest > first[cell] + second[cell]
            np.maximum.at(below, cell[~upper], highest[~upper])
            cell, x, y = cell[upper], x[:, upper], y[:, upper]
            np.minimum.at(above, cell, lowest[upper])
            px, py = self._x[cell], self._y[cell]
            inside = np.min([orient(x[i], y[i], x[j], y[j], px, py) for i, j in ((0, 1), (1, 2), (2, 0))], axis=0)
            np.add.at(over, cell, np.array([2, 1, 0])[inside])  # on an edge, in one, outside
        limit = below + room
        limit[(over != 1) | ~(limit < above) | (self._at(self._x, self._y) != np.arange(len(limit)))] = np.inf
        return limit
