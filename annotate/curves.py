"""Extremes of a surface seen through a distorting lens, in which straight edges become curves.

A lens maps the disk that it sees one to one, so what it shows of a triangle is bounded by the images of the triangle's
edges. The box of a surface inside the image is then the box of all edges' images inside it, and of those corners of the
image that the surface covers. Edges are halved until none that is left can widen the box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.annotate.clipping import clip_triangles, extremes_of_points, next_corner, union_boxes
from hulldown.camera.cameras import NEAR_M
from hulldown.camera.distortion import distort_points, max_bend
from hulldown.camera.frustum import NEAR_PLANE
from hulldown.camera.intrinsics import Intrinsics
from hulldown.geometry.portable import sin_cos

BOX_TOLERANCE_PX = 1e-7  # pixels that edges may still widen a box by when halving ends
MAX_HALVINGS = 60  # of halving; crossings of the image's sides take about 30
FOLD_SAMPLES = 64  # places on the circle of the fold that are compared at a time


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

    def pixels(self, unit: Float[np.ndarray, "2 n"]) -> Float[np.ndarray, "2 n"]:
        """Return pixels of points at unit depth, in the image or not."""
        across, down = distort_points(unit.T, self.intrinsics.distortion).T
        (fx, fy), (cx, cy) = self.intrinsics.focal.tolist(), self.intrinsics.center.tolist()
        return np.stack([across * fx + cx, down * fy + cy])

    def gain(
        self,
        best: Float[np.ndarray, "4"],
        pixels: Sequence[Float[np.ndarray, "2 n"]],
        square: Float[np.ndarray, " n"],
        farthest: Float[np.ndarray, " n"],
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "2 n"], Float[np.ndarray, "2 n"]]:
        """Return how far lines between points may reach beyond a box, and the corners of what holds them.

        `square`, `farthest`: the greatest length squared of a line, and distance from the axis, at unit depth.
        """
        # A curve is no farther from its chord than an eighth of its greatest second derivative.
        sagitta = square * max_bend(farthest, self.intrinsics.distortion) / 8.0
        sagitta = self.intrinsics.focal[:, None] * sagitta
        low, high = reduce(np.minimum, pixels) - sagitta, reduce(np.maximum, pixels) + sagitta
        if self.frame:
            low, high = np.maximum(low, 0.0), np.minimum(high, self.intrinsics.size[:, None])
        gain = _box_excess(best, low, high)
        gain[(low[0] > high[0]) | (low[1] > high[1])] = 0.0
        return gain, low, high

    def are_inside(self, pixels: Float[np.ndarray, "2 n"]) -> Bool[np.ndarray, " n"]:
        """Return which pixels are in the image, if its sides count."""
        (u, v), (width, height) = pixels, self.intrinsics.size.tolist()
        return (u >= 0.0) & (u <= width) & (v >= 0.0) & (v <= height) if self.frame else np.isfinite(u)


def extremes_of_curved(
    points: Float[np.ndarray, "3 v"], faces: Int[np.ndarray, "f 3"], view: CurvedView
) -> Float[np.ndarray, "4"]:
    """Return least and greatest u and v of a mesh in the camera's frame; every point is a corner of a triangle."""
    ahead = points[2] >= NEAR_M
    unit = points[:2] / np.where(ahead, points[2], 1.0)
    radius = view.radius
    known = ahead & (_axis_distance_squared(unit) <= radius * radius)
    pixels = np.full_like(unit, np.nan)
    pixels[:, known] = view.pixels(unit[:, known])
    corners = np.ascontiguousarray(faces.T)
    corners_ahead = ahead[corners]
    whole, some = corners_ahead.all(axis=0), corners_ahead.any(axis=0)
    best = extremes_of_points(pixels.compress(view.are_inside(pixels), axis=1))
    near_border = _may_widen(best, unit, pixels, corners.compress(whole, axis=1), view)
    clipped_points, polygon, _ = clip_triangles(points[:, faces[some & ~whole]], NEAR_PLANE)
    flat = clipped_points[:2] / clipped_points[2]
    start = np.concatenate([unit.take(near_border.ravel(), axis=1), flat], axis=1)
    end = np.concatenate([unit.take(near_border[[1, 2, 0]].ravel(), axis=1), flat[:, next_corner(polygon)]], axis=1)
    start, end = _clip_to_disk(start, end, radius)
    best = _widen_box(best, [start, end, view.pixels(start), view.pixels(end)], view)
    if view.frame or math.isfinite(radius):
        every = points.take(corners.compress(some, axis=1), axis=1)
        for spot, at in zip(*_interior_extremes(view, radius), strict=True):
            if _box_excess(best, at[:, None], at[:, None]).max() > 0.0 and _covers_ray(every, spot):
                best = union_boxes(best, np.concatenate([at, at]))
    return best


def _may_widen(
    best: Float[np.ndarray, "4"],
    unit: Float[np.ndarray, "2 v"],
    pixels: Float[np.ndarray, "2 v"],
    corners: Int[np.ndarray, "3 f"],
    view: CurvedView,
) -> Int[np.ndarray, "3 g"]:
    """Return the corners of the faces whose images may reach beyond a box."""
    places = [unit.take(corner, axis=1) for corner in corners]
    low, high = reduce(np.minimum, places), reduce(np.maximum, places)
    near = _axis_distance_squared(np.maximum(np.maximum(low, -high), 0.0)) <= view.radius**2
    if not near.all():
        corners, low, high = (columns.compress(near, axis=1) for columns in (corners, low, high))
    farthest = np.sqrt(_axis_distance_squared(np.maximum(-low, high)))
    gain, _, _ = view.gain(
        best, [pixels.take(corner, axis=1) for corner in corners], _axis_distance_squared(high - low), farthest
    )
    return corners.compress(~(gain <= 0.0), axis=1)  # nan where a corner isn't seen


def _widen_box(best: Float[np.ndarray, "4"], lines: list[np.ndarray], view: CurvedView) -> Float[np.ndarray, "4"]:
    """Return the box with the images of straight lines at unit depth in it: starts, ends, and the pixels of both."""
    for _ in range(MAX_HALVINGS):
        start, end, first, last = lines
        for pixels in (first, last):
            best = union_boxes(best, extremes_of_points(pixels.compress(view.are_inside(pixels), axis=1)))
        farthest = np.sqrt(np.maximum(_axis_distance_squared(start), _axis_distance_squared(end)))
        gain, low, high = view.gain(best, (first, last), _axis_distance_squared(end - start), farthest)
        nearly = (gain > 0.0) & (gain <= BOX_TOLERANCE_PX)
        some = low[:, nearly].min(axis=1, initial=np.inf), high[:, nearly].max(axis=1, initial=-np.inf)
        best = union_boxes(best, np.concatenate(some))
        left = gain > BOX_TOLERANCE_PX
        if not left.any():
            break
        start, end, first, last = (each.compress(left, axis=1) for each in lines)
        middle = (start + end) / 2.0
        half = view.pixels(middle)
        lines = [np.concatenate(pair, 1) for pair in ((start, middle), (middle, end), (first, half), (half, last))]
    return best


def _axis_distance_squared(points: Float[np.ndarray, "2 *n"]) -> Float[np.ndarray, "*n"]:
    """Return squares of the distances of points from the axis."""
    return points[0] * points[0] + points[1] * points[1]


def _box_excess(
    best: Float[np.ndarray, "4"], low: Float[np.ndarray, "2 n"], high: Float[np.ndarray, "2 n"]
) -> Float[np.ndarray, " n"]:
    """Return how far boxes reach beyond another, where it's farthest; infinite if that one is empty."""
    across = np.maximum(best[0] - low[0], high[0] - best[2])
    return np.maximum(across, np.maximum(best[1] - low[1], high[1] - best[3]))


def _clip_to_disk(
    start: Float[np.ndarray, "2 n"], end: Float[np.ndarray, "2 n"], radius: float
) -> tuple[Float[np.ndarray, "2 m"], Float[np.ndarray, "2 m"]]:
    """Return the parts of lines that are in a disk about the axis."""
    if math.isinf(radius) or not start.size:
        return start, end
    along = end - start
    a, b, c = (
        _axis_distance_squared(along),
        start[0] * along[0] + start[1] * along[1],
        _axis_distance_squared(start) - radius * radius,
    )
    root = b * b - a * c
    met = (root >= 0.0) & ((a > 0.0) | (c <= 0.0))
    start, end, along = start[:, met], end[:, met], along[:, met]
    a, b, root = np.where(a[met] > 0.0, a[met], 1.0), b[met], np.sqrt(root[met])
    first, last = np.maximum((-b - root) / a, 0.0), np.minimum((root - b) / a, 1.0)
    some = first <= last
    start, along, end, first, last = start[:, some], along[:, some], end[:, some], first[some], last[some]
    return np.where(first > 0.0, start + first * along, start), np.where(last < 1.0, start + last * along, end)


def _interior_extremes(view: CurvedView, radius: float) -> tuple[Float[np.ndarray, "4 2"], Float[np.ndarray, "4 2"]]:
    """Return points at unit depth, and their pixels, where what is seen ends and may be extreme inside a triangle.

    They are the image's corners, or the extremes on the circle of the fold.
    """
    if view.frame:
        width, height = view.intrinsics.size.tolist()
        corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
        return view.intrinsics.at_unit_depth(corners), corners
    found = []
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        middle, step = 0.0, 2.0 * math.pi / FOLD_SAMPLES
        for _ in range(8):
            sine, cosine = sin_cos(middle + step * np.arange(-FOLD_SAMPLES / 2, FOLD_SAMPLES / 2 + 1))
            circle = radius * np.stack([cosine, sine])
            best = int((sign * view.pixels(circle)[axis]).argmax())
            middle, step = middle + step * (best - FOLD_SAMPLES / 2), 4.0 * step / FOLD_SAMPLES
        found.append(circle[:, best])
    spots = np.array(found)
    return spots, view.pixels(spots.T).T


def _covers_ray(triangles: Float[np.ndarray, "3 3 f"], spot: Float[np.ndarray, "2"]) -> bool:
    """Return whether a triangle in front of the near plane lies on the ray through a point at unit depth."""
    x, y = spot.tolist()
    across, down = triangles[0] - x * triangles[2], triangles[1] - y * triangles[2]
    following = [1, 2, 0]
    turns = across * down[following] - across[following] * down
    on = (turns >= 0.0).all(axis=0) | (turns <= 0.0).all(axis=0)
    turns, depth = turns.compress(on, axis=1)[following], triangles[2].compress(on, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return bool(((turns * depth).sum(axis=0) / turns.sum(axis=0) >= NEAR_M).any())
