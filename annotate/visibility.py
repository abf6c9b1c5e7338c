"""Visible share of vehicles, by rays at each subject of a camera; small subjects get as many as large ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from hulldown.base.indices import group_and_rank
from hulldown.camera.cameras import Cameras
from hulldown.geometry.transforms import transform_points
from hulldown.scene.camera_pencils import CameraPencils, bound_points_at_unit_depth
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle

# Surfaces this close to the subject don't hide it; float32 rays of a few hundred meters err by a tenth of this.
TOUCHING_M = 1e-3
# Rays of all cameras whose array work is done at once: enough of each model that occurs to be worth its calls.
RAYS_PER_BLOCK = 1 << 18
EMPTY_SCENE = Scene()


@dataclass(frozen=True, eq=False, slots=True)
class Visibility:
    """Visible shares of n cameras' subjects."""

    # visible share of the subject's silhouette in the frame, as it would be with nothing else in the world; nan if no
    # ray met the subject in the frame
    fraction: Float[np.ndarray, " n"]
    hits: Int[np.ndarray, " n"]  # rays that met the subject
    area: Float[np.ndarray, " n"]  # square pixels of the silhouette in the frame


def measure_visibility(
    subjects: Sequence[PosedVehicle], cameras: Cameras, *, world: Scene = EMPTY_SCENE, rays: int = 256, seed: int = 0
) -> Visibility:
    """Return the visible share of each subject, by a jittered ray per cell of its box; nan outside the frame."""
    n = len(cameras)
    for subject in subjects:
        if subject.row is None and len(subject.world_from_vehicle) not in (1, n):
            raise ValueError(f"subjects: expected 1 or {n} poses, got {len(subject.world_from_vehicle)}")
    if rays < 1:
        raise ValueError(f"rays: expected at least 1, got {rays}")
    pattern = jittered_points(rays, rng=np.random.default_rng(seed))
    hits, visible, area = np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n)
    size = max(1, RAYS_PER_BLOCK // rays)
    for index in (np.arange(i, min(i + size, n)) for i in range(0, n, size)):
        posed = [subject.take(index) for subject in subjects]
        found = _ray_counts_and_areas(posed, world.take(index), cameras.take(index), pattern)
        hits[index], visible[index], area[index] = found
    return Visibility(visible / np.where(hits > 0, hits, np.nan), hits, area * hits / rays)


def jittered_points(n: int, *, rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    """Return one uniform point in each of n cells of equal area that tile the unit square."""
    rows = max(1, round(math.sqrt(n)))
    columns = np.full(rows, n // rows)
    columns[: n % rows] += 1
    row, column = group_and_rank(columns)
    # A row is as high as its share of the cells.
    top = (np.cumsum(columns) - columns)[row] / n
    uniform = rng.random((n, 2))
    return np.stack([(column + uniform[:, 0]) / columns[row], top + uniform[:, 1] * columns[row] / n], axis=1)


def _ray_counts_and_areas(
    subjects: list[PosedVehicle], world: Scene, cameras: Cameras, pattern: Float[np.ndarray, "r 2"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """For each camera: the rays on its subject, how many of these see it, and the area that all rays go through."""
    n, r = len(cameras), len(pattern)
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    for subject in subjects:
        camera, parts = subject.cameras_and_posed_parts(cameras.world_from_camera)
        for part, pose in parts:
            box = bound_points_at_unit_depth(transform_points(pose, part.around))
            low[camera] = np.minimum(low[camera], box[:, 0])
            high[camera] = np.maximum(high[camera], box[:, 1])
    first, last = cameras.lenses.window
    pencils, area = _window_pencils_and_areas(np.maximum(low, first), np.minimum(high, last), cameras, pattern)
    distance, asked = np.full(n * r, np.inf), np.repeat(np.where(area > 0.0, np.inf, -np.inf), r)
    for subject in subjects:
        distance = np.minimum(distance, subject.first_hits(pencils, max_distance=asked).distance)
    met = np.flatnonzero(np.isfinite(distance))
    reach = np.where(np.isfinite(distance), distance - TOUCHING_M, -np.inf)
    passed = world.transmittance(pencils, max_distance=reach)[met]
    return np.bincount(met // r, minlength=n), np.bincount(met // r, weights=passed, minlength=n), area


def _window_pencils_and_areas(
    low: Float[np.ndarray, "n 2"], high: Float[np.ndarray, "n 2"], cameras: Cameras, pattern: Float[np.ndarray, "r 2"]
) -> tuple[CameraPencils, Float[np.ndarray, " n"]]:
    extent, poses, lenses = np.clip(high - low, 0.0, None), cameras.world_from_camera, cameras.lenses
    if not lenses.is_distorted:
        return CameraPencils(poses, low, extent, pattern), extent.prod(axis=1) * lenses.focal.prod(axis=-1)
    seen = (extent > 0.0).all(axis=1)
    rows, patterns = np.flatnonzero(seen), np.zeros((len(low), *pattern.shape))
    lenses, area = lenses.take(rows), np.zeros(len(low))
    first, last = lenses.window_pixel_bounds(low[rows], high[rows])
    size = np.clip(last - first, 0.0, None)
    area[rows] = size.prod(axis=1)
    at = lenses.unit_points_from_pixels(first[:, None] + size[:, None] * pattern)
    low[rows] = at.min(axis=1)
    extent[rows] = np.maximum(at.max(axis=1) - low[rows], 1e-300)
    patterns[rows] = (at - low[rows, None]) / extent[rows, None]
    return CameraPencils(poses, low, extent, patterns), area
