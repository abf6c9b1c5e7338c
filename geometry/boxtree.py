"""A bounding volume hierarchy over axis-aligned boxes, in NumPy and float64.

Embree finds the nearest triangle only. Here thousands of queries go down the tree together, one array operation a
level, and find every instance whose box a ray crosses, every triangle near a vehicle, or every face that may lie under
a point. Neighboring rays go as one query. A node's box has the very minima and maxima of its boxes, and comparisons are
exact: whatever touches a box reaches it, without an epsilon.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.base.indices import group_and_rank

TREE_FANOUT = 8
EDGE_SLACK_SHARE = 1e-14  # rounding error of a ray through a box's edge
MIN_DIRECTION_COORDINATE = 1e-200  # a smaller one counts as 0
PACKET_RAYS = 16
MAX_PACKET_SPREAD = 0.1  # difference between the coordinates of its rays' directions
NODE_PAIRS_PER_BLOCK = 1 << 12  # of query and node; what a block touches stays in cache


class BoxTree:
    """A hierarchy over boxes in d dimensions; built once, never changes. Touching counts: all tests are closed."""

    def __init__(self, bounds: Float[np.ndarray, "k 2 d"]) -> None:
        self._order = _morton_order(bounds)
        self._size = (bounds[:, 1] - bounds[:, 0]).mean(axis=0) if len(bounds) else np.zeros(0)
        self._levels: list[Float[np.ndarray, "g 2*d f"]] = []
        d = bounds.shape[2]
        boxes = bounds[self._order].reshape(-1, 2 * d)
        while len(boxes):
            groups = -(-len(boxes) // TREE_FANOUT)
            padded = np.repeat([[np.inf] * d + [-np.inf] * d], groups * TREE_FANOUT, axis=0)  # touched by nothing
            padded[: len(boxes)] = boxes
            grouped = padded.reshape(groups, TREE_FANOUT, 2 * d)
            self._levels.insert(0, np.ascontiguousarray(grouped.transpose(0, 2, 1)))
            if groups == 1:
                break
            boxes = np.concatenate([grouped[..., :d].min(axis=1), grouped[..., d:].max(axis=1)], axis=1)

    def ray_box_crossings(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"], max_distance: Float[np.ndarray, " n"]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Return all boxes that each ray crosses, or nearly, within its distance in lengths of the direction."""
        first = self._packet_starts(origins, directions)
        count = np.diff(first, append=len(origins))
        # A packet's origins and directions lie between these, and every box that one of its rays crosses meets what
        # lies between them. Rounding is monotone, so this holds in float64, too.
        reach = np.maximum.reduceat(max_distance, first) if len(first) else max_distance
        sides = [
            (pick.reduceat(origins, first), pick.reduceat(directions, first)) if len(first) else (origins, directions)
            for pick in (np.minimum, np.maximum)
        ]

        def touch(query: np.ndarray, boxes: np.ndarray) -> np.ndarray:
            enter = np.zeros((len(query), TREE_FANOUT))
            leave = np.repeat(reach[query][:, None], TREE_FANOUT, axis=1)
            for (start, along), box, toward in zip(sides, (boxes[:, 3:], boxes[:, :3]), (1.0, -1.0), strict=True):
                for axis in range(3):
                    # Low sides of the packet must not be above the box, nor high sides below it.
                    speed = along[query, axis][:, None]
                    at = box[:, axis] - start[query, axis][:, None]
                    still, away = np.abs(speed) < MIN_DIRECTION_COORDINATE, speed * toward < -MIN_DIRECTION_COORDINATE
                    if still.any():
                        never = np.where(at * toward >= 0.0, np.inf, -np.inf)
                        at = np.where(still, never, at / np.where(still, 1.0, speed))
                    else:
                        at /= speed
                    if away.any():
                        np.maximum(enter, np.where(away, at, -np.inf), out=enter)
                        at = np.where(away, np.inf, at)
                    np.minimum(leave, at, out=leave)
            return (enter <= leave * (1 + EDGE_SLACK_SHARE)) & (enter < np.inf)

        packet, place = self._touching_pairs(len(first), touch)
        blocks = []
        for i in range(0, max(len(packet), 1), NODE_PAIRS_PER_BLOCK):
            some = packet[i : i + NODE_PAIRS_PER_BLOCK]
            pair, number = group_and_rank(count[some])
            ray, places = first[some][pair] + number, place[i : i + NODE_PAIRS_PER_BLOCK][pair]
            bounds = self._levels[-1][places // TREE_FANOUT, :, places % TREE_FANOUT] if self._levels else np.zeros((0, 6))
            crossed, entry = _crossed_rows_and_entries(bounds, origins[ray], directions[ray], max_distance[ray])
            blocks.append((ray[crossed], self._order[places[crossed]], entry))
        rays, boxes, entry = (np.concatenate(part) for part in zip(*blocks, strict=True))
        return rays, boxes, entry

    def _packet_starts(self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " p"]:
        """Return the first ray of each packet: rays side by side that go much the same way, or one ray alone."""
        block = np.arange(0, len(origins), PACKET_RAYS)
        alone = np.ones(len(block), dtype=bool)
        if len(block) and len(self._size):
            wide, turned = (
                np.maximum.reduceat(rays, block) - np.minimum.reduceat(rays, block) for rays in (origins, directions)
            )
            alone = (wide > self._size).any(axis=1) | (turned > MAX_PACKET_SPREAD).any(axis=1)
        ray = np.arange(len(origins))
        return ray[alone[ray // PACKET_RAYS] | (ray % PACKET_RAYS == 0)]

    def overlapping_pairs(
        self, low: Float[np.ndarray, "n d"], high: Float[np.ndarray, "n d"]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Return all pairs (query, box) where the query's own box touches the box; every pair once."""
        d = low.shape[1]

        def touch(query: np.ndarray, boxes: np.ndarray) -> np.ndarray:
            apart = (boxes[:, :d] > high[query][:, :, None]) | (boxes[:, d:] < low[query][:, :, None])
            return ~apart.any(axis=1)

        query, place = self._touching_pairs(len(low), touch)
        return query, self._order[place]

    def _touching_pairs(
        self, n: int, touch: Callable[[np.ndarray, np.ndarray], Bool[np.ndarray, "v f"]]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Walk all queries down; return the pairs of query and box that touch, boxes by their place in the order."""
        pairs = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))]
        waiting = [(0, np.arange(n), np.zeros(n, dtype=np.int64))] if self._levels else []
        while waiting:
            level, query, node = waiting.pop()
            if len(query) > NODE_PAIRS_PER_BLOCK:
                waiting += [
                    (level, query[i : i + NODE_PAIRS_PER_BLOCK], node[i : i + NODE_PAIRS_PER_BLOCK])
                    for i in range(0, len(query), NODE_PAIRS_PER_BLOCK)
                ]
                continue
            row, slot = np.nonzero(touch(query, self._levels[level][node]))
            child = node[row] * TREE_FANOUT + slot
            if level + 1 < len(self._levels):
                waiting.append((level + 1, query[row], child))
            else:
                pairs.append((query[row], child))
        query, place = (np.concatenate(part) for part in zip(*pairs, strict=True))
        return query, place


def _crossed_rows_and_entries(
    bounds: Float[np.ndarray, "p 6"],
    start: Float[np.ndarray, "p 3"],
    along: Float[np.ndarray, "p 3"],
    reach: Float[np.ndarray, " p"],
) -> tuple[Int[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    entry, leave = np.zeros(len(start)), reach
    for axis in range(3):
        speed = along[:, axis]
        low, high = bounds[:, axis] - start[:, axis], bounds[:, 3 + axis] - start[:, axis]
        parallel = np.abs(speed) < MIN_DIRECTION_COORDINATE
        inverse = 1.0 / np.where(parallel, 1.0, speed)
        a, b = low * inverse, high * inverse
        near, far = np.minimum(a, b), np.maximum(a, b)
        if parallel.any():
            # Such a ray is between the two sides for ever or never.
            near[parallel] = -np.inf
            far[parallel] = np.where((low <= 0.0) & (high >= 0.0), np.inf, -np.inf)[parallel]
        entry, leave = np.maximum(entry, near), np.minimum(leave, far)
    crossed = np.flatnonzero((entry <= leave * (1 + EDGE_SLACK_SHARE)) & (entry < np.inf))
    return crossed, entry[crossed]


def _morton_order(bounds: Float[np.ndarray, "k 2 d"]) -> Int[np.ndarray, " k"]:
    """Return boxes along a Morton curve through their centers, in cubes: a flat axis must not scatter neighbors."""
    if not len(bounds):
        return np.zeros(0, dtype=np.int32)
    center = (bounds[:, 0] + bounds[:, 1]) / 2
    low = center.min(axis=0)
    extent = (center.max(axis=0) - low).max()
    cell = ((center - low) * (1023.0 / (extent if extent > 0 else 1.0))).astype(np.int64)
    for shift, kept in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cell = (cell | cell << shift) & kept  # until each bit is followed by two zeros
    return np.argsort(cell @ 2 ** np.arange(cell.shape[1]), kind="stable").astype(np.int32)
