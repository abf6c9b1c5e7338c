"""The contact footprint of a vehicle, the heights of its underside, and sample points on both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.base.indices import group_and_rank
from hulldown.base.portable import hypot
from hulldown.geometry.hulls import wanted_point_or_centroid
from hulldown.geometry.meshes import Mesh
from hulldown.scene.ray_caster import RayCaster

RASTER_SIDE_CELLS = 128  # on each side of an underside: 3 to 7 cm under a tank
MAX_LEAN_SLOPE = 0.05  # a spot may be this much higher per meter that it is nearer; measured in docs/settling.md
LOWEST_BAND_SHARE = 0.05  # of a mesh's height: this much counts as touching the ground
MIN_FOOTPRINT_SHARE = 0.2  # of the mesh's length and width
MAX_FOOT_HEIGHT_SHARE = 0.01  # of the footprint's longer side: a foot is at most this high above the lowest spot


def contact_footprint(vertices: ArrayLike) -> Float[np.ndarray, "2 2"]:
    """Return low and high (x, y), vehicle frame, of the lowest band of vertices that is wide enough to stand on."""
    points = checked_array(vertices, "vertices", ("v", 3))
    if not len(points):
        raise ValueError("vertices: expected at least one vertex, got none")
    low, high = points.min(axis=0), points.max(axis=0)
    band = LOWEST_BAND_SHARE
    while True:
        touching = points[points[:, 2] <= low[2] + band * (high[2] - low[2]), :2]
        box = np.stack([touching.min(axis=0), touching.max(axis=0)])
        if band >= 1 or (box[1] - box[0] >= MIN_FOOTPRINT_SHARE * (high - low)[:2]).all():
            return box
        band = min(2 * band, 1.0)


@dataclass(frozen=True, eq=False, slots=True)
class Underside:
    """Heights of a vehicle's underside, seen from straight below."""

    # lowest and highest (x, y) of what touches the ground, vehicle frame: its contact footprint
    box: Float[np.ndarray, "2 2"]
    # meters above the vehicle's z = 0 in equal cells of that box, along x and along y; inf where nothing is above the
    # ground
    heights: Float[np.ndarray, "a b"]


def vehicle_underside(mesh: Mesh, *, known: Float[np.ndarray, "a b"] | None = None) -> Underside:
    """Return a mesh's underside at rest: the least hit straight up from each cell's middle, vertex, and edge."""
    used = mesh.vertices[mesh.used_vertex_indices]
    box = contact_footprint(used)
    if (box[0] >= box[1]).any():
        raise ValueError(f"mesh: expected a length and a width, got {mesh.name!r} with the footprint {box.tolist()}")
    if known is not None and known.size:
        return Underside(box, known)
    step = (box[1] - box[0]) / RASTER_SIDE_CELLS
    x, y = (box[0, i] + (np.arange(RASTER_SIDE_CELLS) + 0.5) * step[i] for i in range(2))
    heights = _lowest_face_heights(mesh, np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2))
    points = np.concatenate([used, _points_along_edges(mesh, step)])
    points = points[((points[:, :2] >= box[0]) & (points[:, :2] <= box[1])).all(axis=1)]
    cell = np.minimum(((points[:, :2] - box[0]) / step).astype(np.int64), RASTER_SIDE_CELLS - 1)
    np.minimum.at(heights, cell @ [RASTER_SIDE_CELLS, 1], points[:, 2])
    return Underside(box, heights.reshape(RASTER_SIDE_CELLS, RASTER_SIDE_CELLS))


def _lowest_face_heights(mesh: Mesh, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    start = 2.0 * mesh.bounds[0, 2] - mesh.bounds[1, 2] - 1.0
    face = RayCaster(mesh).cast(np.column_stack([xy, np.full(len(xy), start)]), np.tile([0.0, 0.0, 1.0], (len(xy), 1))).face
    heights = np.full(len(xy), np.inf)
    met = face >= 0
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[face[met]]], 1, 0)
    normal = np.cross(b - a, c - a)
    # Embree finds the face in float32; its height is computed in float64, so that poses keep all digits.
    with np.errstate(divide="ignore", invalid="ignore"):
        z = a[:, 2] - ((xy[met] - a[:, :2]) * normal[:, :2]).sum(axis=1) / normal[:, 2]
    corners = np.stack([a[:, 2], b[:, 2], c[:, 2]])
    heights[met] = np.fmin(np.fmax(z, corners.min(axis=0)), corners.max(axis=0))
    return heights


def _points_along_edges(mesh: Mesh, step: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n 3"]:
    """Return points along all edges that are longer than a step, at most a step apart."""
    points = [np.zeros((0, 3))]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, end = mesh.faces[:, i], mesh.faces[:, j]
        steps = (np.abs(mesh.vertices[end, :2] - mesh.vertices[start, :2]) / step).max(axis=1)
        far = np.flatnonzero(steps > 1)
        pieces = np.ceil(steps[far]).astype(np.int64)
        edge, number = group_and_rank(pieces)
        share = number / pieces[edge]
        first, last = mesh.vertices[start[far[edge]]], mesh.vertices[end[far[edge]]]
        points.append(first + share[:, None] * (last - first))
    return np.concatenate(points)


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Points of a footprint, or of several, at which the ground is compared with the underside."""

    xy: Float[np.ndarray, "... m 2"]  # places in the vehicle frame
    height: Float[np.ndarray, "... m"]  # height of the underside above z = 0; inf where there is none
    foot: Bool[np.ndarray, "... m"]  # whether it's a foot: the underside there is near its lowest point
    # where the center of gravity is taken to be: the middle of the footprint, or the centroid of what can touch the
    # ground if the middle is not above that
    center: Float[np.ndarray, "... 2"]

    def take(self, which: Int[np.ndarray, " k"]) -> Samples:
        """Select the samples of each of k candidates from those of several vehicles."""
        return Samples(self.xy[which], self.height[which], self.foot[which], self.center[which])

    def with_finite_height(self) -> Samples:
        """Return samples below the underside."""
        kept = np.isfinite(self.height)
        return Samples(self.xy[kept], self.height[kept], self.foot[kept], self.center)


def plate_samples(box: Float[np.ndarray, "2 2"], n: int) -> Samples:
    """Return n x n points over a rectangle with its border (n = 1: its middle); all are feet of height 0."""
    share = _even_shares(n)
    x, y = np.meshgrid(*(low + share * (high - low) for low, high in box.T), indexing="ij")
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    center = (xy.min(axis=0) + xy.max(axis=0)) / 2 if n else box.mean(axis=0)
    return Samples(xy, np.zeros(len(xy)), np.ones(len(xy), dtype=bool), center)


def _even_shares(n: int) -> Float[np.ndarray, " n"]:
    return np.linspace(0.0, 1.0, n) if n != 1 else np.array([0.5])


@lru_cache(maxsize=64)
def underside_samples(footprint: Underside, n: int) -> Samples:
    """Return the lowest spot near each of n x n points of an underside; nearer spots win if they're little higher."""
    regular, share = plate_samples(footprint.box, n), _even_shares(n)
    reach = 0.5 / max(n - 1, 1)
    cells = np.array(footprint.heights.shape)
    step = (footprint.box[1] - footprint.box[0]) / cells
    first = np.maximum(np.floor((share[:, None] - reach) * cells), 0).astype(int)
    last = np.minimum(np.ceil((share[:, None] + reach) * cells), cells).astype(int)
    xy, height = regular.xy.copy(), regular.height.copy()
    for k, point in enumerate(np.ndindex(n, n)):
        near, away = [], []
        for axis, i in enumerate(point):
            cell = np.arange(first[i, axis], last[i, axis])
            at = share[i] * cells[axis]
            # In meters, from the point to the nearest place of each cell.
            away.append((np.clip(at, cell, cell + 1) - at) * step[axis])
            near.append(cell)
        heights = footprint.heights[np.ix_(*near)]
        a, b = np.unravel_index(np.argmin(heights + MAX_LEAN_SLOPE * hypot(away[0][:, None], away[1])), heights.shape)
        height[k] = heights[a, b]
        if np.isfinite(height[k]):
            xy[k] += [away[0][a], away[1][b]]
    foot = height <= height.min(initial=np.inf) + MAX_FOOT_HEIGHT_SHARE * np.ptp(footprint.box, axis=0).max()
    return Samples(xy, height, foot, wanted_point_or_centroid(xy[np.isfinite(height)], regular.center))
