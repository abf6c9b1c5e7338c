"""Masks as polygons, for tools that cannot read run lengths."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from geometry.arrays import checked

Point = tuple[int, int]


def polygons(mask: ArrayLike) -> list[list[float]]:
    """Outlines of a mask (h, w) along the edges of its pixels, as COCO polygons (x1, y1, x2, y2, ...).

    Holes are left out: COCO polygons have none. Pixels that touch at a corner only get outlines of their own.
    """
    pixels = checked(mask, "mask", ("h", "w"), dtype=np.bool_)
    outlines = []
    for ring in _rings(_edges(pixels)):
        x, y = ring.T
        # Twice the signed area, positive when clockwise as seen, y pointing down; holes run the other way.
        if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) > 0.0:
            outlines.append(ring.ravel().tolist())
    return outlines


def _edges(pixels: np.ndarray) -> Int[np.ndarray, "n 2 2"]:
    """All pixel edges between mask and not, from one (x, y) to the next, the mask on their right."""
    padded = np.pad(pixels, 1).astype(np.int8)
    edges = []
    for steps, along in ((np.diff(padded, axis=0)[:, 1:-1], (1, 0)), (-np.diff(padded, axis=1)[1:-1], (0, 1))):
        start = np.argwhere(steps)[:, ::-1]
        edge = np.stack([start, start + along], axis=1)
        edges.append(np.where(steps[steps != 0][:, None, None] > 0, edge, edge[:, ::-1]))
    return np.concatenate(edges)


def _rings(edges: Int[np.ndarray, "n 2 2"]) -> list[Float[np.ndarray, "k 2"]]:
    """Closed chains of edges, only the corners where they turn."""
    onward: dict[Point, list[Point]] = {}
    for (x0, y0), (x1, y1) in edges.tolist():
        onward.setdefault((x0, y0), []).append((x1, y1))
    rings = []
    while onward:
        here = next(iter(onward))
        came: Point | None = None
        corners: list[Point] = []
        first: Point | None = None
        while (ways := onward.get(here)) is not None:
            step, there = min(((x - here[0], y - here[1]), (x, y)) for x, y in ways)
            if came is not None and len(ways) > 1:
                # Where two outlines touch at a corner, turning right keeps to the same pixel.
                step = (-came[1], came[0])
                there = (here[0] + step[0], here[1] + step[1])
            ways.remove(there)
            if not ways:
                del onward[here]
            first = first or step
            if step != came:
                corners.append(here)
            came, here = step, there
        # The chain may have begun in the middle of a straight run.
        rings.append(np.array(corners[1:] if came == first else corners, dtype=np.float64))
    return rings
