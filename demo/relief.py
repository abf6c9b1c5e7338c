"""Heights of the demo sceneries: fractal noise and the sheets of terrain made of it. No Blender here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

Field = Float[np.ndarray, "..."]
Height = Callable[[np.ndarray, np.ndarray], np.ndarray]  # z over x and y
COURSE_STEP_M = 2.0
LEVELED_LENGTH_M = 40.0  # a course's ground is averaged over this length


def smoothstep(value: Field, low: Any, high: Any) -> Field:
    """0 below `low`, 1 above `high`, smooth between; falling where low > high."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


class Noise:
    """Smooth random heights of about -1 to 1 over the plane, the same for the same generator state."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._lattice = rng.uniform(-1, 1, (256, 256))

    def __call__(self, x: Field, y: Field, size: float, *, octaves: int = 1, rough: float = 0.5) -> Field:
        """Return noise with hills `size` meters wide, and `octaves` of ever finer ones, each `rough` times as high."""
        total: Field = np.zeros(np.broadcast(x, y).shape)
        for k in range(octaves):
            u, v = x / size * 2.0**k + 17.3 * k, y / size * 2.0**k + 5.9 * k
            i, j = np.floor(u).astype(int), np.floor(v).astype(int)
            s, t = u - i, v - j
            s, t = s * s * s * (s * (s * 6 - 15) + 10), t * t * t * (t * (t * 6 - 15) + 10)
            i, j, i1, j1 = i % 256, j % 256, (i + 1) % 256, (j + 1) % 256
            near = self._lattice[i, j] * (1 - s) + self._lattice[i1, j] * s
            far = self._lattice[i, j1] * (1 - s) + self._lattice[i1, j1] * s
            total = total + rough**k * (near * (1 - t) + far * t)
        return total


class Course:
    """A winding line across the scenery, for a road or a dry river, and the distance of points from it."""

    def __init__(self, corners: Sequence[tuple[float | int, float | int]]) -> None:
        points = np.array(corners, float)
        for _ in range(5):  # Chaikin's corner cutting
            a, b = points[:-1], points[1:]
            cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
            points = np.concatenate([points[:1], cut, points[-1:]])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        self.at = np.arange(0.0, along[-1], COURSE_STEP_M)
        self.xy = np.stack([np.interp(self.at, along, points[:, k]) for k in (0, 1)], axis=-1)
        tangent = np.gradient(self.xy, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        self.left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)

    def nearest(self, x: Field, y: Field) -> tuple[Field, np.ndarray]:
        """Return the distance in meters to the line, and the index of its nearest point, for each (x, y)."""
        distance, index = KDTree(self.xy).query(np.stack(np.broadcast_arrays(x, y), axis=-1))
        return distance, index

    def clear(self, x: Field, y: Field, gap: float) -> Field:
        """1 where a point is farther than `gap` meters from the line, else 0."""
        return (self.nearest(x, y)[0] > gap).astype(float)

    def profile(self, height: Height) -> Field:
        """Heights along the line, averaged over `LEVELED_LENGTH_M` meters, as a road levels its ground."""
        z = height(self.xy[:, 0], self.xy[:, 1])
        n = max(int(LEVELED_LENGTH_M / COURSE_STEP_M) | 1, 3)
        padded = np.pad(z, n // 2, mode="edge")
        return np.convolve(padded, np.ones(n) / n, mode="valid")


def grid_vertices_and_quads(xs: Field, ys: Field, height: Height) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (v, 3) and quads (f, 4) of the terrain over a grid of lines x and y."""
    x, y = np.meshgrid(xs, ys, indexing="ij")
    vertices = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    return vertices, grid_quads(len(xs), len(ys))


def grid_quads(rows: int, columns: int) -> np.ndarray:
    """Quads (f, 4) of vertices numbered row by row: facing up where rows go along x and columns along y."""
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    return np.stack([first, first + columns, first + columns + 1, first + 1], axis=-1)


def ribbon_vertices_and_quads(course: Course, z: Field, across: Field, rise: Field) -> tuple[np.ndarray, np.ndarray]:
    """Return a strip along a course: at each offset to the left a rise above the course's profile z."""
    xy = course.xy[:, None] + course.left[:, None] * across[None, :, None]
    height = z[:, None] + rise[None]
    vertices = np.concatenate([xy, height[..., None]], axis=-1).reshape(-1, 3)
    return vertices, grid_quads(len(course.xy), len(across))
