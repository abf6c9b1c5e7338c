"""Which triangles may lie under a point: a hierarchy of XY grids that no mixture of sizes defeats.

Every face is filed once, in the grid whose cells are just larger than its bounding box, under the cell of its lowest
corner. Only faces of that cell and its three neighbours below and to the left can then lie over a point, on each level.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

_FINEST = 30  # the finest grid has at most 2**30 cells a side, so that a cell's row and column fit one int64
_STRIDE = np.int64(1) << 31
_PAIRS = 1 << 18  # candidates looked at together


@dataclass(frozen=True, eq=False, slots=True)
class _Level:
    exponent: int  # cells are 2**exponent metres wide
    keys: Int[np.ndarray, " k"]
    faces: Int[np.ndarray, " k"]


class FaceIndex:
    """Finds the faces whose XY bounding box may contain a point.

    Parameters
    ----------
    low, high
        (f, 2) corners of the faces' XY bounding boxes.
    """

    def __init__(self, low: Float[np.ndarray, "f 2"], high: Float[np.ndarray, "f 2"]) -> None:
        self._origin = low.min(axis=0)
        extent = (high - low).max(axis=1)
        whole = np.frexp((high.max(axis=0) - self._origin).max())[1]
        level = np.maximum(np.frexp(extent)[1], whole - _FINEST)
        rows = np.arange(len(low))
        self._levels: list[_Level] = []
        while len(rows):
            # A cell index is a monotone function of the coordinate, whatever is rounded on the way.
            current = int(level.min())
            mine = level == current
            first, last = self._cells(low[rows[mine]], current), self._cells(high[rows[mine]], current)
            wide = (last - first > 1).any(axis=1)
            filed = rows[mine][~wide]
            keys = first[~wide] @ np.array([1, _STRIDE])
            order = np.argsort(keys, kind="stable")
            if len(filed):
                self._levels.append(_Level(current, keys[order], filed[order].astype(np.int32)))
            stay = ~mine
            stay[np.flatnonzero(mine)[wide]] = True
            level = np.maximum(level[stay], current + 1)
            rows = rows[stay]

    def candidates(
        self, xy: Float[np.ndarray, "n 2"]
    ) -> Iterator[tuple[slice, Int[np.ndarray, " k"], Int[np.ndarray, " k"]]]:
        """Batches of (which points, the point within the batch, a face), each batch of a bounded size.

        The points must lie within the bounds of all faces.
        """
        starts, counts = [], []
        for level in self._levels:
            column, row = self._cells(xy, level.exponent).T
            for key in (row * _STRIDE + column, (row - 1) * _STRIDE + column):
                start = np.searchsorted(level.keys, key - 1, side="left")
                starts.append(start)
                counts.append(np.searchsorted(level.keys, key, side="right") - start)
        total = np.cumsum(np.sum(counts, axis=0))
        begin = 0
        while begin < len(xy):
            before = total[begin - 1] if begin else 0
            end = max(begin + 1, int(np.searchsorted(total, before + _PAIRS, side="right")))
            batch = slice(begin, end)
            points, faces = [], []
            for i, (start, count) in enumerate(zip(starts, counts, strict=True)):
                n = count[batch]
                point = np.repeat(np.arange(end - begin), n)
                offset = np.arange(len(point)) - np.repeat(np.cumsum(n) - n, n)
                points.append(point)
                faces.append(self._levels[i // 2].faces[np.repeat(start[batch], n) + offset])
            yield batch, np.concatenate(points), np.concatenate(faces)
            begin = end

    def _cells(self, xy: Float[np.ndarray, "n 2"], exponent: int) -> Int[np.ndarray, "n 2"]:
        return np.floor(np.ldexp(xy - self._origin, -exponent)).astype(np.int64)
