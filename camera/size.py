"""Projected size of a target, and the exact distance for a wanted size."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.base.portable import hypot
from hulldown.camera.cameras import Cameras
from hulldown.geometry.transforms import rotate_vectors

Measure = Literal["height", "width", "diagonal", "area"]

# Newton's method on 1 / size, nearly linear in distance, takes 3 to 6 rounds; the others are for bisection.
MAX_SIZE_ROUNDS = 80
SIZE_TOLERANCE = 4e-15
MAX_SECANT_STEPS = 12  # a distorting lens takes 4 to 6


def solve_distance(
    cameras: Cameras, points_world: ArrayLike, *, center: ArrayLike, pixels: ArrayLike, measure: Measure = "height"
) -> Float[np.ndarray, " m"]:
    """Return the distance from the center at which the points' projected box has exactly the wanted size.

    The camera keeps its rotation and moves on the line through `center` and where it is now, so that the center keeps
    its pixel, in the middle of the frame or off it. Along that line a vertex moves on a hyperbola of the distance, away
    from the center's pixel; each side of the box is the outermost of them, and the size falls steadily with distance if
    the center lies inside the points' hull. With a distorting lens, that distance is where a search by secants begins.

    `center`: or (m, 3) world point.
    `pixels`: or (m,) wanted size, positive: of the height, width or diagonal in pixels, of the area in square pixels.
    """
    if measure not in get_args(Measure):
        raise ValueError(f"measure: expected one of {', '.join(get_args(Measure))}, got {measure!r}")
    poses, lenses = cameras.world_from_camera, cameras.lenses
    points = checked_array(points_world, "points_world", ("k", "n", 3))
    m = len(poses)
    middle = np.broadcast_to(checked_array(center, "center", ("...", 3)), (m, 3))
    wanted = np.broadcast_to(checked_array(pixels, "pixels", ("...",)), (m,))
    if (wanted <= 0.0).any():
        raise ValueError(f"pixels: expected positive sizes, got {float(wanted.min())}")
    if len(points) not in (1, m):
        raise ValueError(f"points_world: expected 1 or {m} sets of points, got {len(points)}")
    camera_axes = np.swapaxes(poses[:, :3, :3], -1, -2)
    ray = rotate_vectors(camera_axes, (middle - poses[:, :3, 3])[:, None])[:, 0]
    if (ray[:, 2] <= 0.0).any():
        raise ValueError("center: expected a point in front of every camera")
    ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    local = rotate_vectors(camera_axes, points - middle[:, None])
    # At distance D the pixel of a point is off the center's by f * aside / (D * ray_z + depth).
    aside = (local[..., :2] - local[..., 2:] * (ray[:, None, :2] / ray[:, None, 2:])) * lenses.focal[..., None, :]
    target = np.sqrt(wanted) if measure == "area" else wanted
    distance = _solve_depth(aside, local[..., 2], target, measure) / ray[:, 2]
    if not lenses.is_distorted:
        return distance
    points = local if len(local) == m else np.broadcast_to(local, (m, *local.shape[1:]))

    def size(at: Float[np.ndarray, " k"], rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        seen = lenses.take(rows).project_points(points[rows] + (ray[rows] * at[:, None])[:, None]).pixels
        sides = seen.max(axis=1) - seen.min(axis=1)
        return box_length_by_measure(sides, measure)

    return refine_distance(size, distance, target)


def refine_distance(
    size: Callable[[Float[np.ndarray, " k"], Int[np.ndarray, " k"]], Float[np.ndarray, " k"]],
    distance: Float[np.ndarray, " m"],
    wanted: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """Refine distances by secants until `size`, called with distances and rows, is as wanted; nan stays nan."""
    solution = distance.copy()
    rows = np.flatnonzero(np.isfinite(solution))
    before = solution[rows]
    off_before = wanted[rows] / size(before, rows) - 1.0
    at = before / (1.0 + off_before)
    for _ in range(MAX_SECANT_STEPS):
        if not len(rows):
            break
        off = wanted[rows] / size(at, rows) - 1.0
        solution[rows] = at
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.clip(off * (at - before) / (off - off_before), -0.5 * at, 0.5 * at)
        moving = np.abs(step) > SIZE_TOLERANCE * at
        solution[rows[np.isnan(off)]] = np.nan
        rows, before, off_before, at = rows[moving], at[moving], off[moving], (at - step)[moving]
    return solution


def _solve_depth(
    aside: Float[np.ndarray, "m n 2"], depth: Float[np.ndarray, "m n"], target: Float[np.ndarray, " m"], measure: Measure
) -> Float[np.ndarray, " m"]:
    """Return the depth of the center at which the box around aside / (x + depth) measures `target`."""
    nearest = -depth.min(axis=1)
    widest = np.abs(aside).max(axis=(1, 2))
    scale = np.maximum(np.abs(depth).max(axis=1), 1e-9)
    low = nearest + 1e-9 * scale
    # The size is at most 2 sqrt(2) widest / (x - nearest).
    high = nearest + np.maximum(3.0 * widest / target, 1e-6 * scale)
    x = high
    at_low, _ = _size_and_slope(aside, depth, low, measure)
    possible = (at_low >= target) & (widest > 0.0) & (low < high)
    active = possible
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(MAX_SIZE_ROUNDS):
            size, slope = _size_and_slope(aside, depth, x, measure)
            large = size >= target
            low, high = np.where(active & large, x, low), np.where(active & ~large, x, high)
            # Newton on 1 / size - 1 / target.
            step = x + (1.0 / size - 1.0 / target) * size**2 / slope
            # Closed bounds: at the root the step stays where it is, which is one of them.
            inside = (step >= low) & (step <= high)
            following = np.where(inside, step, 0.5 * (low + high))
            moved = np.abs(following - x) > SIZE_TOLERANCE * np.maximum(np.abs(x), scale)
            x = np.where(active, following, x)
            active = active & moved & (size != target)
            if not active.any():
                break
    return np.where(possible, x, np.nan)


def _size_and_slope(
    aside: Float[np.ndarray, "m n 2"], depth: Float[np.ndarray, "m n"], x: Float[np.ndarray, " m"], measure: Measure
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    inverse = 1.0 / (x[:, None] + depth)
    at = aside * inverse[..., None]
    last, first = at.argmax(axis=1), at.argmin(axis=1)
    row = np.arange(len(x))[:, None]
    axis = np.arange(2)[None]
    high, low = at[row, last, axis], at[row, first, axis]
    sides = high - low
    slopes = -high * inverse[row, last] + low * inverse[row, first]
    size = box_length_by_measure(sides, measure)
    if measure == "height":
        return size, slopes[:, 1]
    if measure == "width":
        return size, slopes[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        if measure == "diagonal":
            return size, (sides * slopes).sum(axis=1) / size
        return size, (sides[:, ::-1] * slopes).sum(axis=1) / (2.0 * size)


def box_length_by_measure(sides: Float[np.ndarray, "... 2"], measure: Measure) -> Float[np.ndarray, "..."]:
    """Return width, height, or diagonal of boxes, or the root of their area, so that all four are lengths."""
    across, down = sides[..., 0], sides[..., 1]
    lengths = {"width": across, "height": down}
    if measure in lengths:
        return np.asarray(lengths[measure])
    return np.asarray(hypot(across, down) if measure == "diagonal" else np.sqrt(across * down))
