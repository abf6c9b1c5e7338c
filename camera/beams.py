"""Obstacles in the way of many pinhole beams: all rays of a beam go down the tree of instances together."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from geometry.instances import InstancedScene

# A beam is cut into so many lengths, whose boxes hold less that is beside the beam than its own would.
LENGTHS = 4
PAIRS = 1 << 18  # pairs of ray and instance tested at a time


def hidden_in_beams(
    scene: InstancedScene,
    origins: Float[np.ndarray, "n 3"],
    corners: Float[np.ndarray, "n 4 3"],
    *,
    ray_origins: Float[np.ndarray, "k 3"],
    ray_directions: Float[np.ndarray, "k 3"],
    ray_beam: Int[np.ndarray, " k"],
    reach: Float[np.ndarray, " k"],
) -> Bool[np.ndarray, " k"]:
    """Whether each ray is blocked; the same answer as `scene.occluded`, which asks the tree ray by ray.

    Parameters
    ----------
    scene
        The obstacles.
    origins, corners
        Apex of each beam and directions along its four edges, in order around it, unit depth; rays are between them.
    ray_origins, ray_directions, reach
        The rays: start, direction of any length, how far in metres.
    ray_beam
        The beam of each ray, ascending.
    """
    hidden = np.zeros(len(ray_beam), dtype=bool)
    if not len(hidden) or not len(scene.bounds):
        return hidden
    first = np.searchsorted(ray_beam, np.arange(len(origins) + 1))
    many = np.diff(first)
    # From the apex to the end of a ray; a beam without rays gets no length.
    ends = reach + np.linalg.norm(ray_origins - origins[ray_beam], axis=1)
    length = np.zeros(len(origins))
    np.maximum.at(length, ray_beam, ends)
    beam, instance = _touched(scene, origins, corners, length=np.where(many > 0, length, np.nan))
    for block in _evenly(many[beam]):
        ray, box = _expanded(first[beam[block]], many[beam[block]], instance[block])
        crossed = _crossed(ray_origins[ray], ray_directions[ray], scene.bounds[box]) & ~hidden[ray]
        ray, box = ray[crossed], box[crossed]
        rays, index = np.unique(ray, return_inverse=True)
        blocked = scene.occluded_by(
            ray_origins[rays], ray_directions[rays], index, instance=box, max_distance=reach[rays]
        )
        hidden[rays[blocked]] = True
    return hidden


def _touched(
    scene: InstancedScene,
    origins: Float[np.ndarray, "n 3"],
    corners: Float[np.ndarray, "n 4 3"],
    *,
    length: Float[np.ndarray, " n"],
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Pairs of beam and instance that may meet; none that do are left out."""
    some = np.flatnonzero(np.isfinite(length))
    stops = np.linspace(0.0, 1.0, LENGTHS + 1)
    edges = origins[some, None, None] + corners[some, None] * (length[some, None] * stops)[..., None, None]
    low, high = edges.min(axis=2), edges.max(axis=2)
    low, high = np.minimum(low[:, :-1], low[:, 1:]), np.maximum(high[:, :-1], high[:, 1:])
    query, instance = scene.overlapping(low.reshape(-1, 3), high.reshape(-1, 3))
    k = len(scene.bounds)
    pairs = np.unique(some[query // LENGTHS] * k + instance)
    beam, instance = pairs // k, pairs % k
    # A box is out if it lies wholly beyond one of the four sides.
    sides = np.cross(corners, np.roll(corners, -1, axis=1))
    inward = np.einsum("nij,nj->ni", sides, corners.sum(axis=1))
    sides *= np.where(inward > 0, -1.0, 1.0)[..., None]
    bounds = scene.bounds[instance]
    middle, half = bounds.mean(axis=1), (bounds[:, 1] - bounds[:, 0]) * (0.5 + 1e-5) + 1e-9
    outward = np.einsum("pij,pj->pi", sides[beam], middle - origins[beam])
    width = np.einsum("pij,pj->pi", np.abs(sides)[beam], half)
    kept = (outward <= width).all(axis=1)
    return beam[kept], instance[kept]


def _crossed(
    origins: Float[np.ndarray, "p 3"], directions: Float[np.ndarray, "p 3"], bounds: Float[np.ndarray, "p 2 3"]
) -> Bool[np.ndarray, " p"]:
    """Whether each ray's line meets the box, a little enlarged, ahead of the origin."""
    pad = 1e-5 * (bounds[:, 1] - bounds[:, 0]) + 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / directions
        a, b = (bounds[:, 0] - pad - origins) * inverse, (bounds[:, 1] + pad - origins) * inverse
    # 0 * inf: the ray runs in a side of the box, which fmin and fmax take for no limit.
    entry, leave = np.fmin(a, b).max(axis=1, initial=0.0), np.fmax(a, b).min(axis=1)
    return ~(entry > leave)


def _evenly(many: Int[np.ndarray, " p"]) -> list[slice]:
    """Consecutive pairs in blocks of about PAIRS rays."""
    block = np.cumsum(many) // PAIRS
    stops = np.flatnonzero(np.diff(block, append=-1)) + 1 if len(many) else np.zeros(0, dtype=np.int64)
    return [slice(int(a), int(b)) for a, b in zip(np.r_[0, stops[:-1]], stops, strict=False)]


def _expanded(
    first: Int[np.ndarray, " p"], many: Int[np.ndarray, " p"], instance: Int[np.ndarray, " p"]
) -> tuple[Int[np.ndarray, " q"], Int[np.ndarray, " q"]]:
    """Every ray of each pair's beam with the pair's instance."""
    starts = np.cumsum(many) - many
    ray = np.arange(int(many.sum())) - np.repeat(starts - first, many)
    return ray, np.repeat(instance, many)
