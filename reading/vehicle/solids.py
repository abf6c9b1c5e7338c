"""A vehicle's pieces where they are, their connected solids, some of which are round, and the wheels among those."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.cluster.hierarchy import fclusterdata
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hulldown.geometry.transforms import transform_points
from hulldown.reading.pieces.roles import Link, Piece

MAX_SOLIDS = 4000  # the largest are kept
ROUND_TOLERANCE = 0.12  # between two second moments of a solid that is round about the third axis
MAX_RIM_GAP_RADIANS = np.radians(65.0)  # between points on the rim of a round solid: a hexagon is round, a box is not
MIN_RIM_RADIUS_SHARE = 0.85  # of the largest radius
MIN_PARALLEL_COSINE = float(np.cos(np.radians(4.0)))
MIN_WHEELS = 4
WHEEL_PLANE_TOLERANCE_RADII = 0.5  # between wheels' centers and their plane


@dataclass(frozen=True, eq=False, slots=True)
class Solids:
    """Connected pieces of surface, in the frame of the points they were found from."""

    piece: Int[np.ndarray, " n"]  # index of the piece each belongs to
    bounds: Float[np.ndarray, "n 2 3"]
    center: Float[np.ndarray, "n 3"]  # middle of its box along its own axes
    axes: Float[np.ndarray, "n 3 3"]  # rows are its own axes, by length: the longest first
    size: Float[np.ndarray, "n 3"]
    round_about: Int[np.ndarray, " n"]  # row of `axes` that it's round about; -1 if it isn't round

    def __len__(self) -> int:
        return len(self.piece)

    @property
    def round_axis(self) -> Float[np.ndarray, "n 3"]:
        """The axis that each solid is round about; the longest if it isn't round."""
        return self.axes[np.arange(len(self)), np.maximum(self.round_about, 0)]

    @property
    def radius(self) -> Float[np.ndarray, " n"]:
        """Radius of each solid across its axle."""
        across = np.where(self.round_about == 0, 1, 0)
        return self.size[np.arange(len(self)), across] / 2

    def rotate_solids(self, rotation: Float[np.ndarray, "3 3"]) -> Solids:
        """Rotate the solids; boxes enclose the rotated solids' own boxes."""
        center, axes = self.center @ rotation.T, self.axes @ rotation.T
        reach = np.einsum("nk,nkj->nj", self.size / 2, np.abs(axes))
        bounds = np.stack([center - reach, center + reach], axis=1)
        return replace(self, bounds=bounds, center=center, axes=axes)

    def where(self, mask: Bool[np.ndarray, " n"] | Int[np.ndarray, " m"]) -> Solids:
        """Select solids."""
        return Solids(*(getattr(self, each.name)[mask] for each in fields(self)))

    def solids_of_pieces(self, kept: Sequence[int]) -> Solids:
        """Select the solids of these ascending pieces, renumbered by their place among them."""
        found = self.where(np.isin(self.piece, kept))
        return replace(found, piece=np.searchsorted(kept, found.piece))


@dataclass(frozen=True, eq=False, slots=True)
class Wheels:
    """A vehicle's wheels."""

    index: Int[np.ndarray, " w"]
    up: Float[np.ndarray, "3"]  # up, across: unit vectors: up from the ground, and along the axles
    across: Float[np.ndarray, "3"]
    level: float  # height along `up` of the ground under them
    places: int  # number of wheels; a tire and its rim are one
    sunk: float  # how far the rest reaches below that ground, in radii


@dataclass(frozen=True, eq=False)
class PlacedPieces:
    """A vehicle's pieces in meters, x forward, z up."""

    pieces: Sequence[Piece]
    points: Sequence[Float[np.ndarray, "_ 3"]]
    solids: Solids  # their solids; if there are none, shapes aren't judged
    markers: Sequence[tuple[Link, ...]]  # the chains of all empties of the file, any of which may be a part's pivot
    vehicle_from_file: Float[np.ndarray, "4 4"]  # from the world of the file

    @cached_property
    def all_vertices(self) -> Float[np.ndarray, "n 3"]:
        """All vertices of all pieces."""
        return np.concatenate([np.zeros((0, 3)), *self.points])

    @cached_property
    def bounds(self) -> Float[np.ndarray, "k 2 3"]:
        """Bounds of each piece."""
        return np.array([[own.min(axis=0), own.max(axis=0)] for own in self.points])

    def origin(self, link: Link) -> Float[np.ndarray, "3"]:
        """Return the origin of an object."""
        return transform_points(self.vehicle_from_file, link.pose[:3, 3][None])[0]

    def where(self, mask: ArrayLike) -> PlacedPieces:
        """Select pieces."""
        kept = np.flatnonzero(mask).tolist()
        pieces, points = [self.pieces[i] for i in kept], [self.points[i] for i in kept]
        return replace(self, pieces=pieces, points=points, solids=self.solids.solids_of_pieces(kept))


def find_solids(points: Sequence[Float[np.ndarray, "_ 3"]], faces: Sequence[Int[np.ndarray, "_ 3"]]) -> Solids:
    """Return the solids of all pieces."""
    owner: list[int] = []
    clouds: list[np.ndarray] = []
    for number, (vertices, triangles) in enumerate(zip(points, faces, strict=True)):
        for cloud in _connected_point_sets(vertices, triangles):
            owner.append(number)
            clouds.append(cloud)
    if len(clouds) > MAX_SOLIDS:
        largest = np.argsort([-float(np.ptp(c, axis=0).max()) for c in clouds])[:MAX_SOLIDS]
        owner, clouds = [owner[i] for i in largest], [clouds[i] for i in largest]
    n = len(clouds)
    axes, size, center, round_about = np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.full(n, -1)
    bounds = np.zeros((n, 2, 3))
    for i, cloud in enumerate(clouds):
        axes[i], size[i], center[i], round_about[i] = _own_box_and_round_axis(cloud)
        bounds[i] = cloud.min(axis=0), cloud.max(axis=0)
    return Solids(np.array(owner, int), bounds, center, axes, size, round_about)


def _connected_point_sets(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> list[Float[np.ndarray, "_ 3"]]:
    """Return points of each connected piece; coincident vertices are merged."""
    used = vertices[faces.ravel()]
    step = max(float(np.ptp(used, axis=0).max()), 1e-30) * 1e-6
    _, first, corner = np.unique(np.round(used / step).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    points, corner = used[first], corner.reshape(-1, 3)
    edges = corner[:, [0, 1, 1, 2]].reshape(-1, 2)
    n = len(points)
    count, label = connected_components(coo_array((np.ones(len(edges)), edges.T), shape=(n, n)), directed=False)
    return np.split(points[np.argsort(label, kind="stable")], np.cumsum(np.bincount(label, minlength=count))[:-1])


def _own_box_and_round_axis(cloud: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Return a solid's own axes, extents, middle, and the axis that it's round about, or -1."""
    off = cloud - cloud.mean(axis=0)
    moments, vectors = np.linalg.eigh(off.T @ off)
    found = -1
    for distinct, pair in ((0, (1, 2)), (2, (0, 1))):
        if len(cloud) < 8 or moments[pair[1]] - moments[pair[0]] > ROUND_TOLERANCE * moments[pair[1]]:
            continue
        across = off @ vectors[:, list(pair)]
        across = across - (across.min(axis=0) + across.max(axis=0)) / 2
        reach = np.linalg.norm(across, axis=1)
        rim = across[reach >= MIN_RIM_RADIUS_SHARE * reach.max()]
        angles = np.sort(np.arctan2(rim[:, 1], rim[:, 0]))
        if np.diff(angles, append=angles[0] + 2 * np.pi).max() < MAX_RIM_GAP_RADIANS:
            found = distinct
            break
    along = off @ vectors
    low, high = along.min(axis=0), along.max(axis=0)
    order = np.argsort(low - high, kind="stable")
    middle = cloud.mean(axis=0) + vectors @ ((low + high) / 2)
    about = -1 if found < 0 else int(np.flatnonzero(order == found)[0])
    return vectors.T[order], (high - low)[order], middle, about


def touching_cluster_labels(
    bounds: Float[np.ndarray, "k 2 3"], slack: Float[np.ndarray, "*k k"] | float
) -> Int[np.ndarray, " k"]:
    """Return the cluster of each box; two boxes with a gap below their slack are in one cluster."""
    near = np.ones((len(bounds), len(bounds)), bool)
    for low, high in zip(bounds[:, 0].T, bounds[:, 1].T, strict=True):
        near &= low[:, None] < high + slack
    _, label = connected_components(near & near.T, directed=False)
    return label


def find_wheels(solids: Solids) -> Wheels | None:
    """Return the largest set of similar discs side by side on one plane, or None."""
    discs = np.flatnonzero(
        (solids.round_about >= 0)
        & (solids.size[np.arange(len(solids)), np.maximum(solids.round_about, 0)] < 2.5 * solids.radius)
    )
    axle, radius, center = solids.round_axis[discs], solids.radius[discs], solids.center[discs]
    best, best_score = None, 0.0
    left = np.ones(len(discs), bool)
    for seed in np.argsort(-radius):
        if not left[seed] or radius[seed] <= 0:
            continue
        alike = (
            (np.abs(axle @ axle[seed]) > MIN_PARALLEL_COSINE) & (radius > 0.75 * radius[seed]) & (radius < 1.34 * radius[seed])
        )
        left &= ~alike
        found = _wheel_score_axes_and_mask(center[alike], radius[alike], axle[seed])
        if found is not None and found[0] > best_score:
            best_score, best = found[0], (discs[alike][found[3]], *found[1:3])
    if best is None:
        return None
    index, up, across = best
    middle = solids.center[index].mean(axis=0)
    # The body is on the side where the vehicle reaches farther, floors and other sheets aside.
    thick = solids.size[:, 2] > 0.02 * solids.size[:, 0]
    heights = (solids.center[thick] - middle) @ up
    weight = solids.size[thick].prod(axis=1) ** (1 / 3)
    if float(heights @ weight) < 0:
        up = -up
    level = float((solids.center[index] @ up - solids.radius[index]).min())
    # A tire and its rim are one wheel.
    joined = fclusterdata(solids.center[index], 0.7 * float(solids.radius[index].mean()), criterion="distance")
    reach = np.einsum("nk,nk->n", solids.size / 2, np.abs(solids.axes @ up))
    sunk = (level - float((solids.center @ up - reach)[thick].min())) / float(solids.radius[index].mean())
    return Wheels(index, up, across, level, places=int(joined.max()), sunk=sunk)


def _wheel_score_axes_and_mask(
    center: Float[np.ndarray, "n 3"], radius: Float[np.ndarray, " n"], axle: Float[np.ndarray, "3"]
) -> tuple[float, np.ndarray, np.ndarray, Bool[np.ndarray, " n"]] | None:
    """Return score, up (either way), and axle of the discs, and which of them are wheels; None if too few are."""
    keep = np.ones(len(center), bool)
    for _ in range(3):
        if keep.sum() < MIN_WHEELS:
            return None
        off = center[keep] - np.median(center[keep], axis=0)
        along_axle = off @ axle
        flat = off - along_axle[:, None] * axle
        _, _, directions = np.linalg.svd(flat, full_matrices=False)
        ahead = directions[0] - (directions[0] @ axle) * axle
        ahead /= np.linalg.norm(ahead)
        up = np.cross(ahead, axle)
        up /= np.linalg.norm(up)
        lift = np.abs((center - np.median(center[keep], axis=0)) @ up)
        within = lift < WHEEL_PLANE_TOLERANCE_RADII * np.median(radius)
        if (within == keep).all():
            break
        keep = within
    size = float(np.median(radius[keep])) if keep.any() else 0.0
    if keep.sum() < MIN_WHEELS:
        return None
    base, track = float(np.ptp(center[keep] @ ahead)), float(np.ptp(center[keep] @ axle))
    if not (3.0 * size < base < 40.0 * size and 1.5 * size < track < base * 1.6):
        return None
    return base * track * size, up, axle, keep
