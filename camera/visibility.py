"""Visible share of targets, by rays at each target; small targets get as many as large ones."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from hulldown.assets.vehicle import Articulation
from hulldown.camera.camera_rays import CameraRays, box_at_unit_depth
from hulldown.camera.lenses import Lenses, Optics, lenses
from hulldown.camera.target import PosedVehicle, VehicleTarget
from hulldown.camera.world import BATCH, World
from hulldown.geometry.arrays import checked, numbered
from hulldown.geometry.rays import WorkerThreads
from hulldown.geometry.transforms import apply, invert_rigid

# Surfaces this close to the target don't hide it; float32 rays of a few hundred meters err by a tenth of this.
TOUCHING = 1e-3
# Rays of all cameras whose array work is done at once: enough of each model that occurs to be worth its calls.
BLOCK = 1 << 18


@dataclass(frozen=True, eq=False, slots=True)
class Visibility:
    """Visible and hidden shares of n cameras' targets.

    Shares are of the target's silhouette in the frame, as it would be with nothing else in the world; they add up to 1.
    All are nan if no ray met the target in the frame.

    Parameters
    ----------
    fraction
        (n,) visible share.
    by_ground
        (n,) share hidden by the ground.
    by_obstacles
        (n,) share hidden by obstacles and not by the ground.
    by_vehicles
        (n,) share hidden by other vehicles and nothing else.
    hits
        (n,) rays that met the target.
    area
        (n,) square pixels of the silhouette in the frame.
    """

    fraction: Float[np.ndarray, " n"]
    by_ground: Float[np.ndarray, " n"]
    by_obstacles: Float[np.ndarray, " n"]
    by_vehicles: Float[np.ndarray, " n"]
    hits: Int[np.ndarray, " n"]
    area: Float[np.ndarray, " n"]


def error_bound(hits: ArrayLike, *, confidence: float = 0.95) -> Float[np.ndarray, "..."]:
    """Bound the error of a visible share from so many rays on the target, at a confidence.

    Every ray is uniformly random in its own cell of the target's box. With p the true fraction, V
    and M the numbers of visible rays and of rays on the target, V - p M is a sum of independent terms of mean 0 within
    [-1, 1], whose variances add up to at most p (1 - p) E[M]. So the standard error is at most 1 / (2 sqrt(M)), and by
    Bernstein's inequality |V / M - p| <= (L / 3 + sqrt(L^2 / 9 + L M / 2)) / M, L = ln(2 / (1 - confidence)), where M
    stands in for its mean. This holds for any silhouette and any occluders; usual ones
    are several times better, since cells that no edge crosses have no error.

    References
    ----------
    Boucheron, Lugosi, Massart, Concentration Inequalities, 2013, theorem 2.10 (Bernstein).
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: expected a number between 0 and 1, got {confidence}")
    m = checked(hits, "hits", ("...",))
    log = math.log(2.0 / (1.0 - confidence))
    with np.errstate(divide="ignore"):
        return np.where(m > 0, np.minimum((log / 3 + np.sqrt(log**2 / 9 + log * m / 2)) / m, 1.0), np.nan)


def visible_fraction(
    target: VehicleTarget,
    world_from_vehicle: ArrayLike,
    world_from_camera: ArrayLike,
    *,
    intrinsics: Optics,
    articulation: Articulation | Sequence[Articulation] | None = None,
    world: World | None = None,
    rays: int = 256,
    seed: int = 0,
    threads: int = 1,
) -> Visibility:
    """Visible share of each target's silhouette in its camera's frame.

    Rays go through jittered points in the part of the frame that the target's projected box covers, one a cell of a
    grid over it. Those that meet the vehicle, moved into its own frame and part by part, are silhouette; what meets
    something else first is hidden. Targets smaller than a pixel are sampled like any other.

    Parameters
    ----------
    target
        The vehicle.
    world_from_vehicle
        (n, 4, 4) rigid poses, or (1, 4, 4) for one vehicle that all cameras look at.
    world_from_camera
        (n, 4, 4) rigid poses. Nothing nearer than `camera.projection.NEAR` is seen.
    intrinsics
        One, or one for each camera.
    articulation
        Part name to radians; one for all, or a sequence of n. None: at rest.
    world
        Occluders: ground, obstacles, and other vehicles, each in one pose or in n. None: no occluders.
    rays
        Rays into the target's box for each camera; `error_bound` has their error.
    seed
        Seed of the jitter, which is the same for all cameras, so a result doesn't depend on the other cameras.
    threads
        How many threads share the work.

    Returns
    -------
    Visibility
        nan for targets out of the frame.
    """
    vehicles = checked(world_from_vehicle, "world_from_vehicle", ("m", 4, 4))
    n = len(np.asarray(world_from_camera))
    if len(vehicles) not in (1, n):
        raise ValueError(f"world_from_vehicle: expected 1 or {n} poses, got {len(vehicles)}")
    if not isinstance(articulation, Mapping | None) and len(articulation) != n:
        raise ValueError(f"articulation: expected one or {n}, got {len(articulation)}")
    subject = PosedVehicle(target, vehicles, articulation or {})
    around = world or World()
    return visibility_of(
        [subject], world_from_camera, intrinsics=intrinsics, world=around, rays=rays, seed=seed, threads=threads
    )


def visibility_of(
    subjects: Sequence[PosedVehicle],
    world_from_camera: ArrayLike,
    *,
    intrinsics: Optics,
    world: World,
    rays: int = 256,
    seed: int = 0,
    threads: int = 1,
) -> Visibility:
    """`visible_fraction` for several models: each camera looks at one pose of one model.

    Parameters
    ----------
    subjects
        The vehicles that are looked at.
    world_from_camera, intrinsics, world, rays, seed, threads
        See `visible_fraction`.
    """
    poses = checked(world_from_camera, "world_from_camera", ("n", 4, 4))
    n = len(poses)
    if rays < 1:
        raise ValueError(f"rays: expected at least 1, got {rays}")
    pattern = jittered(rays, rng=np.random.default_rng(seed))
    lens = lenses(intrinsics).spread(n)
    counts, area = np.zeros((n, 5)), np.zeros(n)

    def work(index: Int[np.ndarray, " k"]) -> None:
        posed = [subject.rows(index) for subject in subjects]
        counts[index], area[index] = _count(posed, world.rows(index), poses[index], lens.rows(index), pattern)

    size = max(1, BLOCK // rays)
    blocks = [np.arange(i, min(i + size, n)) for i in range(0, n, size)]
    with WorkerThreads(min(threads, max(len(blocks), 1))) as pool:
        for _ in pool.map(work, blocks):
            pass
    hits = counts[:, 0].astype(np.int64)
    share = counts[:, 1:] / np.where(hits > 0, hits, np.nan)[:, None]
    return Visibility(share[:, 0], share[:, 1], share[:, 2], share[:, 3], hits, area * hits / rays)


def jittered(n: int, *, rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    """One uniform point in each of n cells of equal area that tile the unit square."""
    rows = max(1, round(math.sqrt(n)))
    columns = np.full(rows, n // rows)
    columns[: n % rows] += 1
    row, column = numbered(columns)
    # A row is as high as its share of the cells.
    top = (np.cumsum(columns) - columns)[row] / n
    uniform = rng.random((n, 2))
    return np.stack([(column + uniform[:, 0]) / columns[row], top + uniform[:, 1] * columns[row] / n], axis=1)


def _count(
    subjects: list[PosedVehicle],
    world: World,
    world_from_camera: Float[np.ndarray, "n 4 4"],
    lens: Lenses,
    pattern: Float[np.ndarray, "r 2"],
) -> tuple[Float[np.ndarray, "n 5"], Float[np.ndarray, " n"]]:
    """For each camera: rays on its subject, visible, hidden by ground, obstacles, vehicles; their area."""
    n, r = len(world_from_camera), len(pattern)
    low, high = np.full((n, 2), np.inf), np.full((n, 2), -np.inf)
    parts = []
    for subject in subjects:
        camera, placed = subject.seen_from(world_from_camera)
        for part, pose in placed:
            box = box_at_unit_depth(apply(pose, part.around))
            low[camera] = np.minimum(low[camera], box[:, 0])
            high[camera] = np.maximum(high[camera], box[:, 1])
            parts.append((part, pose, box, camera))
    first, last = lens.window
    low, high = np.maximum(low, first), np.minimum(high, last)
    camera_rays, area = _rays(low, high, lens, pattern)
    in_frame = area > 0.0

    distance = np.full(n * r, np.inf)
    for part, pose, box, camera in parts:
        part_from_camera = invert_rigid(pose)
        inside = np.flatnonzero(camera_rays.inside(box, camera) & in_frame[camera, None])
        for i in range(0, len(inside), BATCH):
            asked = inside[i : i + BATCH]
            hits = part.caster.cast(*camera_rays.rays(part_from_camera, asked, camera))
            at = camera[asked // r] * r + asked % r
            distance[at] = np.minimum(distance[at], hits.distance)
    met = np.flatnonzero(np.isfinite(distance))
    passed = world.passed(camera_rays, world_from_camera, which=met, reach=distance[met] - TOUCHING)
    shares = np.column_stack([passed[:, 2], -np.diff(passed, axis=1, prepend=1.0)])
    counts = [np.bincount(met // r, weights=w, minlength=n) for w in (np.ones(len(met)), *shares.T)]
    return np.stack(counts, axis=1, dtype=np.float64), area


def _rays(
    low: Float[np.ndarray, "n 2"], high: Float[np.ndarray, "n 2"], lens: Lenses, pattern: Float[np.ndarray, "r 2"]
) -> tuple[CameraRays, Float[np.ndarray, " n"]]:
    """Rays in windows at unit depth, uniform in the image, and the area of the windows in square pixels."""
    extent = np.clip(high - low, 0.0, None)
    if not lens.distorted:
        return CameraRays(low, extent, pattern), extent.prod(axis=1) * lens.focal.prod(axis=1)
    seen = (extent > 0.0).all(axis=1)
    rows, patterns = np.flatnonzero(seen), np.zeros((len(low), *pattern.shape))
    lens, area = lens.rows(rows), np.zeros(len(low))
    first, last = lens.image_of(low[rows], high[rows])
    size = np.clip(last - first, 0.0, None)
    area[rows] = size.prod(axis=1)
    at = lens.at_unit_depth(first[:, None] + size[:, None] * pattern)
    low[rows] = at.min(axis=1)
    extent[rows] = np.maximum(at.max(axis=1) - low[rows], 1e-300)
    patterns[rows] = (at - low[rows, None]) / extent[rows, None]
    return CameraRays(low, extent, patterns), area
