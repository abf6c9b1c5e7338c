"""A mesh of prisms along hair curves that hides as much as the hair.

Grass is made of hair. It is drawn as round strands along splines through the curves' points; a prism whose outline is
as long as the strand's has the strand's width on average over all sides (Cauchy: the mean width of a convex outline
is its length / pi). Six sides and four times as many pieces bring a mask one thousandth nearer to Cycles'.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.geometry.meshes import Mesh

PRISM_SIDES = 4
RIM_ANGLES = 2 * np.pi * np.arange(PRISM_SIDES) / PRISM_SIDES
# A polygon in a circle of this many radii has an outline as long as a circle of one.
PRISM_WIDENING = np.pi / (PRISM_SIDES * np.sin(np.pi / PRISM_SIDES))
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
RIM_INDICES = np.arange(PRISM_SIDES)
NEXT_RIM_INDICES = np.roll(RIM_INDICES, -1)
PRISM_FACES = np.concatenate(
    [
        np.stack([RIM_INDICES, NEXT_RIM_INDICES, NEXT_RIM_INDICES + PRISM_SIDES], 1),
        np.stack([RIM_INDICES, NEXT_RIM_INDICES + PRISM_SIDES, RIM_INDICES + PRISM_SIDES], 1),
    ]
)
MAX_AXIS_RADII = 1.0  # from a prism's axis to the strand's
PIECE_TOLERANCE = 1e-6  # so much of a piece is rounding
MAX_STRETCHES = 1 << 18  # their mesh has some hundred megabytes; of more, some are taken and made thicker
MAX_STRETCH_PIECES = 4  # Cycles too divides the stretch between two points so by default

# Points a, b, c, d to the cubic between b and c of the Catmull-Rom spline through them: rows are powers of t.
CATMULL_ROM = np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2


def hair_mesh(
    points: Float[np.ndarray, "p 3"],
    radii: Float[np.ndarray, " p"],
    first: Int[np.ndarray, " c"],
    straight: Bool[np.ndarray, " c"],
    name: str,
) -> Mesh | None:
    """Make prisms along every curve; of too much fur, one in k stretches, k times as thick (Cook et al., 2007)."""
    is_first, is_last = np.zeros((2, len(points)), dtype=bool)
    is_first[first], is_last[first - 1] = True, True
    b = np.flatnonzero(~is_last)
    thicker = -(-len(b) // MAX_STRETCHES)
    if thicker > 1:
        b = np.sort(np.random.default_rng(0).permutation(b)[: len(b) // thicker])
    a, d = b - ~is_first[b], b + 1 + ~is_last[b + 1]
    strand = np.concatenate([points, thicker * radii[:, None]], axis=1)
    corners = np.stack([strand[a], strand[b], strand[b + 1], strand[d]], axis=1)
    cubic = CATMULL_ROM @ corners
    linear = np.repeat(straight, np.diff(first, append=len(points)))[b]
    cubic[linear, 1], cubic[linear, 2:] = strand[b + 1][linear] - strand[b][linear], 0.0
    count = _subdivision_counts(cubic, thicker * (radii[b] + radii[b + 1]) / 2)
    ends = np.concatenate([_cut_cubics_evenly(cubic[count == n], n) for n in range(1, MAX_STRETCH_PIECES + 1)])
    return _make_prisms(ends[..., :3], np.maximum(ends[..., 3], 0.0), name)


def _subdivision_counts(cubic: Float[np.ndarray, "s 4 4"], radius: Float[np.ndarray, " s"]) -> Int[np.ndarray, " s"]:
    """Return the number of pieces: a chord over t of 1 / n errs by up to 1/8 of the greatest second derivative / n^2.

    The part of the derivative along the stretch doesn't bend it.
    """
    chord = cubic[:, 1:, :3].sum(axis=1)
    second = np.stack([2 * cubic[:, 2, :3], 2 * cubic[:, 2, :3] + 6 * cubic[:, 3, :3]])
    with np.errstate(divide="ignore", invalid="ignore"):
        bend = np.linalg.norm(np.cross(second, chord), axis=-1).max(axis=0) / np.linalg.norm(chord, axis=1)
        count = np.ceil(np.sqrt(bend / (8 * MAX_AXIS_RADII * radius)) - PIECE_TOLERANCE)
    return np.clip(np.nan_to_num(count, nan=1.0), 1, MAX_STRETCH_PIECES).astype(np.int64)


def _cut_cubics_evenly(cubic: Float[np.ndarray, "s 4 4"], n: int) -> Float[np.ndarray, "k 2 4"]:
    at = (np.arange(n + 1)[:, None] / n) ** np.arange(4) @ cubic
    return np.stack([at[:, :-1], at[:, 1:]], axis=2).reshape(-1, 2, 4)


def _make_prisms(ends: Float[np.ndarray, "k 2 3"], radii: Float[np.ndarray, "k 2"], name: str) -> Mesh | None:
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    seen = ~((length == 0.0) | (radii.sum(axis=1) == 0.0))
    if not seen.any():
        return None
    ends, radii, along = ends[seen], radii[seen], along[seen] / length[seen, None]
    # Across a strand: any direction that is far from along it.
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    # Blades of grass are parallel: turned alike, all prisms would be too wide, or too narrow, from the same side.
    turn = (RIM_ANGLES + GOLDEN_ANGLE * np.arange(len(ends))[:, None])[..., None]
    spokes = np.cos(turn) * across[:, None] + np.sin(turn) * np.cross(along, across)[:, None]
    vertices = ends[:, :, None] + PRISM_WIDENING * radii[:, :, None, None] * spokes[:, None]
    faces = 2 * PRISM_SIDES * np.arange(len(ends))[:, None, None] + PRISM_FACES
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3).astype(np.int32), name)
