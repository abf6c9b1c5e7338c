"""Find triangles that may contain a point seen from above, by a hierarchy of XY grids for any mixture of sizes.

Every face is filed once, under the cell of its lowest corner, on a level whose cells are at least half as wide as its
bounding box. The index g of a cell is monotone, and a face whose computed cells span more than two steps is moved a
level up. So if a face contains p, then g(low) ≤ g(p) ≤ g(high) ≤ g(low) + 2, and looking at g(p), g(p) − 1, and
g(p) − 2 in either direction on each level finds it, without an epsilon.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from hulldown.geometry.arrays import numbered

_FINEST = 30  # the finest grid has at most 2**30 cells a side, so that a cell's row and column fit one int64
_STRIDE = np.int64(1) << 31
_PAIRS = 1 << 15  # candidates looked at together, so that intermediate arrays stay in cache
_REACH = 2  # how many cells further than its first a face may extend


@dataclass(frozen=True, eq=False, slots=True)
class _Level:
    exponent: int  # cells are 2**exponent meters wide
    keys: Int[np.ndarray, " k"]
    faces: Int[np.ndarray, " k"]


class FaceIndex:
    """Finds the faces whose XY bounding box may contain a point.

    Parameters
    ----------
    low, high
        (2, f) lowest and highest x and y of the faces.
    """

    def __init__(self, low: Float[np.ndarray, "2 f"], high: Float[np.ndarray, "2 f"]) -> None:
        self._origin = low.min(axis=1)
        whole = np.frexp((high.max(axis=1) - self._origin).max())[1]
        share, level = np.frexp((high - low).max(axis=0))
        level -= 1 + (share == 0.5)  # half the extent rounded up to a power of two
        level = np.maximum(level, whole - _FINEST)
        rows = np.arange(level.size)
        self._levels: list[_Level] = []
        while len(rows):
            # A cell index is a monotone function of the coordinate, whatever is rounded on the way.
            current = int(level.min())
            on_level = level == current
            filed = rows[on_level]
            keys, wide = np.zeros(len(filed), dtype=np.int64), np.zeros(len(filed), dtype=bool)
            for axis, stride in ((0, 1), (1, _STRIDE)):
                first = self._cells(low[axis, filed], axis, current)
                wide |= self._cells(high[axis, filed], axis, current) - first > _REACH
                first *= stride
                keys += first
            filed, keys = filed[~wide], keys[~wide]
            order = np.argsort(keys, kind="stable")
            if len(filed):
                self._levels.append(_Level(current, keys[order], filed[order].astype(np.int32)))
            stay = ~on_level
            stay[np.flatnonzero(on_level)[wide]] = True
            level = np.maximum(level[stay], current + 1)
            rows = rows[stay]

    def candidates(
        self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]
    ) -> Iterator[tuple[slice, Int[np.ndarray, " k"], Int[np.ndarray, " k"]]]:
        """Batches of (which points, the point within the batch, a face), each batch of a bounded size.

        The points must lie within the bounds of all faces.
        """
        starts, counts = [], []
        for level in self._levels:
            column, row = self._cells(x, 0, level.exponent), self._cells(y, 1, level.exponent)
            for key in ((row - r) * _STRIDE + column for r in range(_REACH + 1)):
                start = np.searchsorted(level.keys, key - _REACH, side="left")
                starts.append(start)
                counts.append(np.searchsorted(level.keys, key, side="right") - start)
        total = np.cumsum(np.sum(counts, axis=0))
        begin = 0
        while begin < len(x):
            before = total[begin - 1] if begin else 0
            end = max(begin + 1, int(np.searchsorted(total, before + _PAIRS, side="right")))
            batch = slice(begin, end)
            points, faces = [], []
            for i, (start, count) in enumerate(zip(starts, counts, strict=True)):
                n = count[batch]
                point, number = numbered(n)
                points.append(point)
                faces.append(self._levels[i // (_REACH + 1)].faces[start[batch][point] + number])
            yield batch, np.concatenate(points), np.concatenate(faces)
            begin = end

    def _cells(self, values: Float[np.ndarray, " n"], axis: int, exponent: int) -> Int[np.ndarray, " n"]:
        return np.ldexp(values - self._origin[axis], -exponent).astype(np.int64)
