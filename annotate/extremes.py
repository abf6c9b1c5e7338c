"""Extremes of a surface in an image: the sides of its box.

A lens without distortion has straight edges, which are clipped exactly. Through others they become curves. Such a lens
maps the disk that it sees one to one, so what it shows of a triangle is bounded by the images of the triangle's edges.
The box of a surface inside the image is then the box of all edges' images inside it, and of those corners of the image
that the surface covers. Edges are halved until none that is left can widen the box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.annotate.clipping import (
    EMPTY_EXTREMES,
    clip_triangles_to_polygons,
    extremes_of_points,
    next_corner_indices,
    signed_plane_distances,
    union_extremes,
)
from hulldown.base.portable import sin_cos
from hulldown.camera.cameras import NEAR_M
from hulldown.camera.distortion import distort_points, max_second_derivative
from hulldown.camera.intrinsics import Intrinsics

NEAR_PLANE = np.array([[0.0, 0.0, 1.0, -NEAR_M]])
MAX_COORDINATE_PX = 1e9  # bounds a lens's polynomial far off its axis, so that plans can store its values
BOX_TOLERANCE_PX = 1e-7  # halving ends when edges can widen a box by no more
MAX_HALVINGS = 60  # crossings of the image's sides take about 30
FOLD_CIRCLE_SAMPLES = 64  # compared at a time


@dataclass(frozen=True, eq=False)
class ImageView:
    """A camera, and the limits of what it sees."""

    lens: Intrinsics
    clip_to_image: bool  # whether the image's sides bound what is seen, or the near plane and a lens's fold alone

    @cached_property
    def focal_center_and_size(self) -> tuple[list[float], list[float], list[float]]:
        """Focal lengths, principal point, and image size in pixels."""
        return self.lens.focal.tolist(), self.lens.center.tolist(), self.lens.size.tolist()

    @property
    def clip_planes(self) -> Float[np.ndarray, "k 4"]:
        """Rows (a, b, c, d) with a x + b y + c z + d >= 0 inside: near, then left, right, upper, and lower side."""
        if not self.clip_to_image:
            return NEAR_PLANE
        (fx, fy), (cx, cy), (width, height) = self.focal_center_and_size
        sides = [[fx, 0.0, cx, 0.0], [-fx, 0.0, width - cx, 0.0], [0.0, fy, cy, 0.0], [0.0, -fy, height - cy, 0.0]]
        return np.concatenate([NEAR_PLANE, sides])

    @property
    def sight_radius(self) -> float:
        """Distance from the axis at unit depth, beyond which nothing is seen."""
        x, y = self.lens.half_tangents
        return min(self.lens.lens_seen_radius, math.sqrt(x * x + y * y)) if self.clip_to_image else self.lens.lens_seen_radius

    def pixels(self, unit: Float[np.ndarray, "2 n"]) -> Float[np.ndarray, "2 n"]:
        """Return pixels of points at unit depth, in the image or not."""
        (u, v), ((fx, fy), (cx, cy), _) = unit, self.focal_center_and_size
        if self.lens.is_distorted:
            u, v = distort_points(unit.T, self.lens.distortion).T
        return np.stack([u * fx + cx, v * fy + cy])

    def box_gain_and_bounds(
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
        sagitta = square * max_second_derivative(farthest, self.lens.distortion) / 8.0
        sagitta = self.lens.focal[:, None] * sagitta
        low, high = reduce(np.minimum, pixels) - sagitta, reduce(np.maximum, pixels) + sagitta
        if self.clip_to_image:
            low, high = np.maximum(low, 0.0), np.minimum(high, self.lens.size[:, None])
        gain = _box_excess(best, low, high)
        gain[(low[0] > high[0]) | (low[1] > high[1])] = 0.0
        return gain, low, high

    def inside_mask(self, pixels: Float[np.ndarray, "2 n"]) -> Bool[np.ndarray, " n"]:
        """Return which pixels are in the image, if its sides count."""
        (u, v), (width, height) = pixels, self.lens.size.tolist()
        return (u >= 0.0) & (u <= width) & (v >= 0.0) & (v <= height) if self.clip_to_image else np.isfinite(u)


def surface_extremes(
    points: Float[np.ndarray, "3 v"], faces: Int[np.ndarray, "f 3"], view: ImageView
) -> Float[np.ndarray, "4"]:
    """Return least and greatest u and v of a mesh in the camera's frame: (inf, inf, -inf, -inf) if nothing is seen."""
    return (_curved_extremes if view.lens.is_distorted else _straight_extremes)(points, faces, view)


def _straight_extremes(
    points: Float[np.ndarray, "3 v"], faces: Int[np.ndarray, "f 3"], view: ImageView
) -> Float[np.ndarray, "4"]:
    """Clip the triangles that straddle a plane: the extremes of straight edges are at their ends."""
    planes = view.clip_planes
    outside = np.zeros(points.shape[1], dtype=np.uint8)  # as bits, the planes that each point is outside of
    for i, plane in enumerate(planes):
        outside |= (signed_plane_distances(plane, points) < 0.0).astype(np.uint8) << np.uint8(i)
    a, b, c = outside[faces[:, 0]], outside[faces[:, 1]], outside[faces[:, 2]]
    straddling = faces[((a | b | c) != 0) & ((a & b & c) == 0)]
    inner = points.compress(outside == 0, axis=1)
    cut, _, on = clip_triangles_to_polygons(points[:, straddling], planes)
    inner, cut = view.pixels(inner[:2] / inner[2]), view.pixels(cut[:2] / cut[2])
    width, height = view.focal_center_and_size[2]
    if view.clip_to_image:
        for pixels in (inner, cut):  # against rounding
            np.clip(pixels[0], 0.0, width, out=pixels[0])
            np.clip(pixels[1], 0.0, height, out=pixels[1])
    # A corner cut by an edge of the image is exactly on it.
    for bit, (axis, side) in enumerate(((0, 0.0), (0, width), (1, 0.0), (1, height)), start=1):
        cut[axis, on >> bit & 1 == 1] = side
    return union_extremes(extremes_of_points(inner), extremes_of_points(cut))


def _curved_extremes(
    points: Float[np.ndarray, "3 v"], faces: Int[np.ndarray, "f 3"], view: ImageView
) -> Float[np.ndarray, "4"]:
    """Return the extremes through a distorting lens, within pixels that plans can store."""
    ahead = points[2] >= NEAR_M
    unit = points[:2] / np.where(ahead, points[2], 1.0)
    radius = view.sight_radius
    known = ahead & (_squared_length(unit) <= radius * radius)
    pixels = np.full_like(unit, np.nan)
    pixels[:, known] = view.pixels(unit[:, known])
    corners = np.ascontiguousarray(faces.T)
    corners_ahead = ahead[corners]
    whole, some = corners_ahead.all(axis=0), corners_ahead.any(axis=0)
    best = extremes_of_points(pixels.compress(view.inside_mask(pixels), axis=1))
    near_border = _triangles_that_may_widen(best, unit, pixels, corners.compress(whole, axis=1), view)
    clipped_points, polygon, _ = clip_triangles_to_polygons(points[:, faces[some & ~whole]], NEAR_PLANE)
    flat = clipped_points[:2] / clipped_points[2]
    start = np.concatenate([unit.take(near_border.ravel(), axis=1), flat], axis=1)
    end = np.concatenate([unit.take(near_border[[1, 2, 0]].ravel(), axis=1), flat[:, next_corner_indices(polygon)]], axis=1)
    start, end = _clip_lines_to_disk(start, end, radius)
    best = _widen_box(best, [start, end, view.pixels(start), view.pixels(end)], view)
    if view.clip_to_image or math.isfinite(radius):
        every = points.take(corners.compress(some, axis=1), axis=1)
        for spot, at in zip(*_interior_extreme_candidates(view, radius), strict=True):
            if _box_excess(best, at[:, None], at[:, None]).max() > 0.0 and _any_triangle_covers_ray(every, spot):
                best = union_extremes(best, np.concatenate([at, at]))
    return np.clip(best, -MAX_COORDINATE_PX, MAX_COORDINATE_PX) if best[0] <= best[2] else EMPTY_EXTREMES


def _triangles_that_may_widen(
    best: Float[np.ndarray, "4"],
    unit: Float[np.ndarray, "2 v"],
    pixels: Float[np.ndarray, "2 v"],
    corners: Int[np.ndarray, "3 f"],
    view: ImageView,
) -> Int[np.ndarray, "3 g"]:
    places = [unit.take(corner, axis=1) for corner in corners]
    low, high = reduce(np.minimum, places), reduce(np.maximum, places)
    near = _squared_length(np.maximum(np.maximum(low, -high), 0.0)) <= view.sight_radius**2
    if not near.all():
        corners, low, high = (columns.compress(near, axis=1) for columns in (corners, low, high))
    farthest = np.sqrt(_squared_length(np.maximum(-low, high)))
    gain, _, _ = view.box_gain_and_bounds(
        best, [pixels.take(corner, axis=1) for corner in corners], _squared_length(high - low), farthest
    )
    return corners.compress(~(gain <= 0.0), axis=1)  # nan where a corner isn't seen


def _widen_box(best: Float[np.ndarray, "4"], lines: list[np.ndarray], view: ImageView) -> Float[np.ndarray, "4"]:
    """Return the box with the images of straight lines at unit depth in it: starts, ends, and the pixels of both."""
    for _ in range(MAX_HALVINGS):
        start, end, first, last = lines
        for pixels in (first, last):
            best = union_extremes(best, extremes_of_points(pixels.compress(view.inside_mask(pixels), axis=1)))
        farthest = np.sqrt(np.maximum(_squared_length(start), _squared_length(end)))
        gain, low, high = view.box_gain_and_bounds(best, (first, last), _squared_length(end - start), farthest)
        nearly = (gain > 0.0) & (gain <= BOX_TOLERANCE_PX)
        some = low[:, nearly].min(axis=1, initial=np.inf), high[:, nearly].max(axis=1, initial=-np.inf)
        best = union_extremes(best, np.concatenate(some))
        left = gain > BOX_TOLERANCE_PX
        if not left.any():
            break
        start, end, first, last = (each.compress(left, axis=1) for each in lines)
        middle = (start + end) / 2.0
        half = view.pixels(middle)
        lines = [np.concatenate(pair, 1) for pair in ((start, middle), (middle, end), (first, half), (half, last))]
    return best


def _squared_length(points: Float[np.ndarray, "2 *n"]) -> Float[np.ndarray, "*n"]:
    return points[0] * points[0] + points[1] * points[1]


def _box_excess(
    best: Float[np.ndarray, "4"], low: Float[np.ndarray, "2 n"], high: Float[np.ndarray, "2 n"]
) -> Float[np.ndarray, " n"]:
    """Return how far boxes reach beyond another, where it's farthest; infinite if that one is empty."""
    across = np.maximum(best[0] - low[0], high[0] - best[2])
    return np.maximum(across, np.maximum(best[1] - low[1], high[1] - best[3]))


def _clip_lines_to_disk(
    start: Float[np.ndarray, "2 n"], end: Float[np.ndarray, "2 n"], radius: float
) -> tuple[Float[np.ndarray, "2 m"], Float[np.ndarray, "2 m"]]:
    """Return the parts of lines that are in a disk about the axis."""
    if math.isinf(radius) or not start.size:
        return start, end
    along = end - start
    a, b, c = (_squared_length(along), start[0] * along[0] + start[1] * along[1], _squared_length(start) - radius * radius)
    root = b * b - a * c
    met = (root >= 0.0) & ((a > 0.0) | (c <= 0.0))
    start, end, along = start[:, met], end[:, met], along[:, met]
    a, b, root = np.where(a[met] > 0.0, a[met], 1.0), b[met], np.sqrt(root[met])
    first, last = np.maximum((-b - root) / a, 0.0), np.minimum((root - b) / a, 1.0)
    some = first <= last
    start, along, end, first, last = start[:, some], along[:, some], end[:, some], first[some], last[some]
    return np.where(first > 0.0, start + first * along, start), np.where(last < 1.0, start + last * along, end)


def _interior_extreme_candidates(view: ImageView, radius: float) -> tuple[Float[np.ndarray, "4 2"], Float[np.ndarray, "4 2"]]:
    """Return points that may be extreme inside a triangle, and their pixels: image corners, extremes on the fold."""
    if view.clip_to_image:
        width, height = view.lens.size.tolist()
        corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
        return view.lens.unit_points_from_pixels(corners), corners
    found = []
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        middle, step = 0.0, 2.0 * math.pi / FOLD_CIRCLE_SAMPLES
        for _ in range(8):
            sine, cosine = sin_cos(middle + step * np.arange(-FOLD_CIRCLE_SAMPLES / 2, FOLD_CIRCLE_SAMPLES / 2 + 1))
            circle = radius * np.stack([cosine, sine])
            best = int((sign * view.pixels(circle)[axis]).argmax())
            middle, step = middle + step * (best - FOLD_CIRCLE_SAMPLES / 2), 4.0 * step / FOLD_CIRCLE_SAMPLES
        found.append(circle[:, best])
    spots = np.array(found)
    return spots, view.pixels(spots.T).T


def _any_triangle_covers_ray(triangles: Float[np.ndarray, "3 3 f"], spot: Float[np.ndarray, "2"]) -> bool:
    """Return whether a triangle in front of the near plane covers the ray through a point at unit depth."""
    x, y = spot.tolist()
    across, down = triangles[0] - x * triangles[2], triangles[1] - y * triangles[2]
    following = [1, 2, 0]
    turns = across * down[following] - across[following] * down
    on = (turns >= 0.0).all(axis=0) | (turns <= 0.0).all(axis=0)
    turns, depth = turns.compress(on, axis=1)[following], triangles[2].compress(on, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return bool(((turns * depth).sum(axis=0) / turns.sum(axis=0) >= NEAR_M).any())
