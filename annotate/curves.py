"""Extremes of a surface seen through a distorting lens, in which straight edges become curves.

A lens maps the disk that it sees one to one, so what it shows of a triangle is bounded by the images of the triangle's
edges. The box of a surface inside the image is then the box of all edges' images inside it, and of those corners of the
image that the surface covers. Edges are halved until none that is left can widen the box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.annotate.clipping import clipped, extremes_of_points, next_corner, union
from hulldown.camera.distortion import bend, distorted, jacobian
from hulldown.camera.frustum import NEAR_PLANE
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import NEAR
from hulldown.geometry.portable import sin_cos

CLOSE = 1e-7  # pixels that edges may still widen a box by when halving ends
ROUNDS = 60  # of halving; crossings of the image's sides take about 30
AROUND = 64  # places on the circle of the fold that are compared at a time


@dataclass(frozen=True, eq=False, slots=True)
class CurvedView:
    """The view of one camera with a distorting lens."""

    intrinsics: Intrinsics
    frame: bool  # whether the image's sides bound what is seen, or the lens's fold alone

    @property
    def radius(self) -> float:
        """Distance from the axis at unit depth, beyond which nothing is seen."""
        x, y = self.intrinsics.half_tangents
        return min(self.intrinsics.radius, math.sqrt(x * x + y * y)) if self.frame else self.intrinsics.radius

    def pixels(self, unit: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Return pixels of points at unit depth, in the image or not."""
        return distorted(unit, self.intrinsics.distortion) * self.intrinsics.focal + self.intrinsics.center

    def seen(self, points: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "4"]:
        """Extremes of the points that are seen, in the camera's frame."""
        unit = (points[:2, points[2] >= NEAR] / points[2, points[2] >= NEAR]).T
        pixels = self.pixels(unit[(unit * unit).sum(axis=1) <= self.radius**2])
        return extremes_of_points(pixels[self.inside(pixels)].T)

    def may_widen(
        self, best: Float[np.ndarray, "4"], low: Float[np.ndarray, "n 2"], high: Float[np.ndarray, "n 2"]
    ) -> Bool[np.ndarray, " n"]:
        """Return whether what is in rectangles at unit depth may reach beyond a box; nan: it may."""
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        across, both, down = jacobian(middle, self.intrinsics.distortion)
        linear = np.stack([np.abs(across), np.abs(both), np.abs(down)], 1)
        reach = np.stack([(linear[:, :2] * half).sum(axis=1), (linear[:, 1:] * half).sum(axis=1)], 1)
        square = (half * half).sum(axis=1)
        farthest = np.sqrt((middle * middle).sum(axis=1)) + np.sqrt(square)
        reach = (reach + (square * bend(farthest, self.intrinsics.distortion) / 2.0)[:, None]) * self.intrinsics.focal
        pixels = self.pixels(middle)
        first, last = self.cut(pixels - reach, pixels + reach)
        nearest = np.maximum(np.maximum(low, -high), 0.0)
        outside = (nearest * nearest).sum(axis=1) > self.radius**2
        return ~(outside | (first > last).any(axis=1) | (_beyond(best, first.T, last.T) <= 0.0))

    def cut(self, low: Float[np.ndarray, "n 2"], high: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
        """Clip boxes in pixels to the image, if its sides count."""
        return (np.maximum(low, 0.0), np.minimum(high, self.intrinsics.size)) if self.frame else (low, high)

    def inside(self, pixels: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Return which pixels are in the image, if its sides count."""
        return (
            ((pixels >= 0.0) & (pixels <= self.intrinsics.size)).all(axis=1)
            if self.frame
            else np.isfinite(pixels[:, 0])
        )


def extremes_of_curved(
    points: Float[np.ndarray, "3 v"], faces: Int[np.ndarray, "f 3"], view: CurvedView, best: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "4"]:
    """Return least and greatest u and v of a mesh in the camera's frame, and of a box that may be empty."""
    ahead = points[2] >= NEAR
    depth = np.where(ahead, points[2], 1.0)
    unit = np.stack([points[0] / depth, points[1] / depth], 1)
    radius = view.radius
    known = ahead & ((unit * unit).sum(axis=1) <= radius * radius)
    pixels = np.full_like(unit, np.nan)
    pixels[known] = view.pixels(unit[known])
    corners_ahead = ahead[faces]
    whole, cut = corners_ahead.all(axis=1), corners_ahead.any(axis=1) & ~corners_ahead.all(axis=1)
    start, end = (faces[whole][:, k].ravel() for k in ([0, 1, 2], [1, 2, 0]))
    both = known[start] & known[end]
    of_faces = [unit[start[both]], unit[end[both]], pixels[start[both]], pixels[end[both]]]
    # Edges that leave the disk, and those of triangles that the near plane cuts, are shortened first.
    leaving = [unit[start[~both]], unit[end[~both]]]
    if cut.any():
        corners, polygon, _ = clipped(points[:, faces[cut]], NEAR_PLANE)
        flat = (corners[:2] / corners[2]).T
        leaving = [np.concatenate(pair) for pair in zip(leaving, (flat, flat[next_corner(polygon)]), strict=True)]
    short = _within(leaving[0], leaving[1], radius)
    lines = [np.concatenate(pair) for pair in zip(of_faces, (*short, *map(view.pixels, short)), strict=True)]
    seen = np.zeros(len(unit), dtype=bool)
    seen[faces[whole]] = True
    best = union(best, extremes_of_points(pixels[seen & known & view.inside(pixels)].T))
    best = _widened(best, lines, view)
    if view.frame or math.isfinite(radius):
        every = points[:, faces[whole | cut]]
        for spot, at in zip(*_special(view, radius), strict=True):
            if _beyond(best, at, at).max() > 0.0 and _covers(every, spot):
                best = union(best, np.concatenate([at, at]))
    return best


def _widened(best: Float[np.ndarray, "4"], lines: list[np.ndarray], view: CurvedView) -> Float[np.ndarray, "4"]:
    """Return the box with the images of straight lines at unit depth in it: starts, ends, and the pixels of both."""
    for _ in range(ROUNDS):
        start, end, first, last = lines
        for pixels in (first, last):
            best = union(best, extremes_of_points(pixels[view.inside(pixels)].T))
        along = end - start
        square = (along * along).sum(axis=1)
        farthest = np.sqrt(np.maximum((start * start).sum(axis=1), (end * end).sum(axis=1)))
        # A curve is no farther from its chord than an eighth of its greatest second derivative.
        sagitta = (square * bend(farthest, view.intrinsics.distortion) / 8.0)[:, None] * view.intrinsics.focal
        low, high = np.minimum(first, last) - sagitta, np.maximum(first, last) + sagitta
        low, high = view.cut(low, high)
        gain = np.where((low <= high).all(axis=1), _beyond(best, low.T, high.T), 0.0)
        nearly = (gain > 0.0) & (gain <= CLOSE)
        best = union(best, np.array([*low[nearly].min(axis=0, initial=np.inf), *high[nearly].max(0, initial=-np.inf)]))
        left = gain > CLOSE
        if not left.any():
            break
        start, end, first, last = (each[left] for each in lines)
        middle = (start + end) / 2.0
        half = view.pixels(middle)
        lines = [np.concatenate(pair) for pair in ((start, middle), (middle, end), (first, half), (half, last))]
    return best


def _beyond(best: Float[np.ndarray, "4"], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return how far boxes (2, ...) reach beyond another, where it's farthest; infinite if that one is empty."""
    return np.asarray(np.max([best[0] - low[0], best[1] - low[1], high[0] - best[2], high[1] - best[3]], axis=0))


def _within(
    start: Float[np.ndarray, "n 2"], end: Float[np.ndarray, "n 2"], radius: float
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 2"]]:
    """Return the parts of lines that are in a disk about the axis."""
    if math.isinf(radius) or not len(start):
        return start, end
    along = end - start
    a, b = (along * along).sum(axis=1), (start * along).sum(axis=1)
    c = (start * start).sum(axis=1) - radius * radius
    root = b * b - a * c
    met = (root >= 0.0) & ((a > 0.0) | (c <= 0.0))
    start, end, along = start[met], end[met], along[met]
    a, b, root = np.where(a[met] > 0.0, a[met], 1.0), b[met], np.sqrt(root[met])
    first, last = np.maximum((-b - root) / a, 0.0), np.minimum((root - b) / a, 1.0)
    some = first <= last
    start, along, end = start[some], along[some], end[some]
    first, last = first[some, None], last[some, None]
    return np.where(first > 0.0, start + first * along, start), np.where(last < 1.0, start + last * along, end)


def _special(view: CurvedView, radius: float) -> tuple[Float[np.ndarray, "4 2"], Float[np.ndarray, "4 2"]]:
    """Return points at unit depth, and their pixels, where what is seen ends and may be extreme inside a triangle.

    They are the image's corners, or the extremes on the circle of the fold.
    """
    if view.frame:
        width, height = view.intrinsics.size.tolist()
        corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
        return view.intrinsics.at_unit_depth(corners), corners
    found = []
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        middle, step = 0.0, 2.0 * math.pi / AROUND
        for _ in range(8):
            sine, cosine = sin_cos(middle + step * np.arange(-AROUND / 2, AROUND / 2 + 1))
            circle = radius * np.stack([cosine, sine], 1)
            best = int((sign * view.pixels(circle)[:, axis]).argmax())
            middle, step = middle + step * (best - AROUND / 2), 4.0 * step / AROUND
        found.append(circle[best])
    spots = np.array(found)
    return spots, view.pixels(spots)


def _covers(triangles: Float[np.ndarray, "3 f 3"], spot: Float[np.ndarray, "2"]) -> bool:
    """Return whether a triangle in front of the near plane lies on the ray through a point at unit depth."""
    x, y = spot.tolist()
    across, down = triangles[0] - x * triangles[2], triangles[1] - y * triangles[2]
    following = [1, 2, 0]
    turns = across * down[:, following] - across[:, following] * down
    on = (turns >= 0.0).all(axis=1) | (turns <= 0.0).all(axis=1)
    turns, depth = turns[on][:, [1, 2, 0]], triangles[2][on]
    area = turns.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return bool(((turns * depth).sum(axis=1) / area >= NEAR).any())
