"""Which of many axis-aligned boxes does each query touch: a bounding volume hierarchy in NumPy, in float64.

Embree answers for the nearest triangle only. Finding every instance whose box a ray crosses, or every triangle near a
vehicle, needs all boxes; here thousands of queries go down the tree together, one array operation a level.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

FANOUT = 8
SLACK = 1e-14  # what rounding may take from a ray that runs through an edge of a box
VISITS = 1 << 12  # (query, node) pairs expanded at a time: what they touch stays in cache


@dataclass(frozen=True, eq=False, slots=True)
class Crossings:
    """Which rays cross which boxes.

    Parameters
    ----------
    ray, box
        (p,) indices, in no particular order; every pair once.
    entry
        (p,) distance from the origin to the box along the ray; 0 where the origin lies inside.
    """

    ray: Int[np.ndarray, " p"]
    box: Int[np.ndarray, " p"]
    entry: Float[np.ndarray, " p"]


class BoxTree:
    """A hierarchy over boxes; built once, never changes. Touching counts: all tests are closed.

    Parameters
    ----------
    bounds
        (k, 2, 3) lowest and highest corners; k = 0 is legal.
    """

    def __init__(self, bounds: Float[np.ndarray, "k 2 3"]) -> None:
        self._order = _morton_order(bounds)
        self._levels: list[Float[np.ndarray, "g 6 f"]] = []
        boxes = bounds[self._order].reshape(-1, 6)
        while len(boxes):
            groups = -(-len(boxes) // FANOUT)
            padded = np.full((groups * FANOUT, 6), np.inf)  # boxes at infinity are touched by nothing
            padded[: len(boxes)] = boxes
            level = padded.reshape(groups, FANOUT, 6).transpose(0, 2, 1)
            self._levels.insert(0, np.ascontiguousarray(level))
            if groups == 1:
                break
            filled = np.where(np.isinf(level), np.nan, level)
            boxes = np.concatenate([np.nanmin(filled[:, :3], axis=2), np.nanmax(filled[:, 3:], axis=2)], axis=1)

    def crossed(
        self,
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        max_distance: Float[np.ndarray, " n"],
    ) -> Crossings:
        """All boxes that each ray crosses within its distance, which counts in lengths of the direction.

        A box that a ray passes by less than rounding may be among them.
        """
        parallel = np.abs(directions) < 1e-200
        inverse = 1.0 / np.where(parallel, 1.0, directions)
        some_parallel = parallel.any(axis=0)
        entries: list[np.ndarray] = []

        def touch(query: np.ndarray, boxes: np.ndarray) -> np.ndarray:
            entry = np.zeros((len(query), FANOUT))
            leave = np.repeat(max_distance[query][:, None], FANOUT, axis=1)
            for axis in range(3):
                start, along = origins[query, axis][:, None], inverse[query, axis][:, None]
                a, b = boxes[:, axis], boxes[:, axis + 3]
                if some_parallel[axis]:
                    aside = ((a > start) | (b < start)) & parallel[query, axis][:, None]
                for side in (a, b):
                    side -= start
                    side *= along
                near, far = np.minimum(a, b), np.maximum(a, b)
                if some_parallel[axis]:
                    # Such a ray is between the two sides for ever or never.
                    near[parallel[query, axis]], far[parallel[query, axis]] = -np.inf, np.inf
                    far[aside] = -np.inf
                np.maximum(entry, near, out=entry)
                np.minimum(leave, far, out=leave)
            leave *= 1 + SLACK
            crossed = (entry <= leave) & (entry < np.inf)
            entries[:] = [entry[crossed]]
            return crossed

        rays, boxes, kept = self._descend(len(origins), touch, entries)
        return Crossings(rays, boxes, kept)

    def overlapping(
        self, low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """All pairs (query, box) where the query's own box touches the box; every pair once."""

        def touch(query: np.ndarray, boxes: np.ndarray) -> np.ndarray:
            apart = (boxes[:, :3] > high[query][:, :, None]) | (boxes[:, 3:] < low[query][:, :, None])
            return ~apart.any(axis=1)

        queries, boxes, _ = self._descend(len(low), touch, [])
        return queries, boxes

    def _descend(
        self, n: int, touch: Callable[[np.ndarray, np.ndarray], Bool[np.ndarray, "v f"]], extra: list[np.ndarray]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Walks all queries down; `touch` may overwrite the boxes it is given.

        What it leaves in `extra` at the leaves is gathered along with the pairs.
        """
        found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        waiting = [(0, np.arange(n), np.zeros(n, dtype=np.int64))] if self._levels else []
        while waiting:
            level, query, node = waiting.pop()
            if len(query) > VISITS:
                waiting += [(level, query[i : i + VISITS], node[i : i + VISITS]) for i in range(0, len(query), VISITS)]
                continue
            touched = touch(query, self._levels[level][node])
            row, slot = np.nonzero(touched)
            child = node[row] * FANOUT + slot
            if level + 1 < len(self._levels):
                waiting.append((level + 1, query[row], child))
            else:
                found.append((query[row], self._order[child], extra[0] if extra else np.zeros(len(row))))
        if not found:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
        query, box, value = (np.concatenate(part) for part in zip(*found, strict=True))
        return query, box, value


def _morton_order(bounds: Float[np.ndarray, "k 2 3"]) -> Int[np.ndarray, " k"]:
    """Boxes along a Morton curve through their centres, in cubes of a 1024th of the widest axis.

    Cubes, so that an axis of little extent (the height of trees in a wood) does not scatter neighbours along the curve.
    """
    if not len(bounds):
        return np.zeros(0, dtype=np.int64)
    centre = bounds.mean(axis=1)
    extent = np.ptp(centre, axis=0).max()
    cell = ((centre - centre.min(axis=0)) * (1023.0 / (extent if extent > 0 else 1.0))).astype(np.int64)
    key = np.zeros(len(bounds), dtype=np.int64)
    for axis in range(3):
        for bit in range(10):
            key |= (cell[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")
