"""The contents of a hard file: objects as plain arrays, and litter around a vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

PARTS = ("hull", "turret", "gun")
LITTER_PART = 3  # the part of what is no vehicle


@dataclass(frozen=True, eq=False, slots=True)
class Thing:
    """One object, its vertices where they are drawn, its origin, and the index of what it hangs from (-1: nothing)."""

    name: str
    part: int
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    origin: Float[np.ndarray, "3"]
    parent: int = -1
    hidden: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Model:
    """A vehicle as objects, x forward, z up, meters; and the pivots of its turret and gun (None for none)."""

    things: tuple[Thing, ...]
    pivots: tuple[Float[np.ndarray, "3"] | None, Float[np.ndarray, "3"] | None]


def node(name: str, part: int, origin: Float[np.ndarray, "3"], parent: int = -1) -> Thing:
    """An object without a mesh."""
    return Thing(name, part, np.empty((0, 3)), np.empty((0, 3), int), origin, parent)


def make_litter(model: Model, litter: str, *, scrambled: bool) -> list[Thing]:
    """The objects of one kind of litter, where it would lie."""
    points = np.concatenate([t.vertices for t in model.things if len(t.faces)])
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    middle = (low + high) / 2
    ground = np.array([middle[0], middle[1], low[2]])
    name = (lambda n: f"Object_{900 + len(n)}") if scrambled else str
    floor = [24, 24, 0.1], [*middle[:2], low[2] - 0.05]
    boxes = {
        "floor": (name("Floor"), *floor),
        "plain floor": ("Plane", *floor),
        "probe": (name("chrome_ball"), [0.5, 0.5, 0.5], [high[0] + 1.0, middle[1] + 2.0, low[2] + 1.0]),
        "plinth": (name("Plinth"), [1.2 * size[0], 1.4 * size[1], 0.4], [*middle[:2], low[2] - 0.2]),
        "figure": ("Human_Reference", [0.35, 0.5, 1.8], [middle[0], high[1] + 1.0, low[2] + 0.9]),
    }
    if litter in boxes:
        called, extent, at = boxes[litter]
        return [_thing(called, *_box(extent, at))]
    if litter == "backdrop":
        arc = np.linspace(0, np.pi / 2, 9)
        profile = [(8.0, 0.0), *((-8 - 4 * np.sin(a), 4 - 4 * np.cos(a)) for a in arc), (-12.0, 12.0)]
        rows = np.array([[x, y, z] for y in (-10.0, 10.0) for x, z in profile]) + ground
        n = len(profile)
        faces = np.array([f for i in range(n - 1) for f in ((i, i + 1, n + i), (i + 1, n + i + 1, n + i))])
        return [_thing(name("Cyc"), rows, faces)]
    if litter in ("hidden cube", "cube below"):
        at = [middle[0], middle[1], low[2]] if litter == "hidden cube" else [0.8, -0.4, low[2] - 0.7]
        cube = replace(_thing("Cube", *_box([2, 2, 2], [0, 0, 0])), hidden=litter == "hidden cube")
        return [replace(cube, vertices=cube.vertices + at, origin=np.array(at))]
    if litter == "hidden planes":
        side = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) * [0.8 * size[0], 1, 0.8 * size[2]] + middle
        front = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) * [1, size[1], size[2]] + middle
        quad = np.array([[0, 1, 2], [0, 2, 3]])
        return [replace(_thing(n, v, quad), hidden=True) for n, v in (("blueprint side", side), ("bp2", front))]
    if litter == "light card":
        above = np.array([middle[0], middle[1], high[2]])
        card = np.array([[-2, -2, 3], [2, -2, 3], [2, 2, 3], [-2, 2, 3]]) + above
        return [_thing(name("Softbox"), card, np.array([[0, 1, 2], [0, 2, 3]]))]
    if litter == "turntable":
        around = np.linspace(0, 2 * np.pi, 33)[:-1]
        rim = np.stack([size[0] * np.cos(around), size[0] * np.sin(around), np.full(32, low[2])], axis=1)
        faces = np.array([(0, k, k + 1) for k in range(1, 31)])
        return [_thing(name("Disc"), rim + np.array([middle[0], middle[1], 0]), faces)]
    return []


def _thing(name: str, vertices: np.ndarray, faces: np.ndarray) -> Thing:
    return Thing(name, LITTER_PART, np.asarray(vertices, float), faces, np.zeros(3))


def _box(size: Sequence[float], at: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners * size + at, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
