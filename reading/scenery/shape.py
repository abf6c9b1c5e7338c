"""Classify pieces by shape: ground without such a name, sheets that may be water, domes around everything."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hulldown.geometry.meshes import Mesh
from hulldown.geometry.transforms import transform_points
from hulldown.reading.pieces.roles import MAX_SHEET_THICKNESS_SHARE, Piece

MIN_LEVEL_COSINE = np.cos(np.radians(30.0))  # of a level face's inclination
MIN_LEVEL_SHARE = 0.5  # of a level piece's area; a box twice as wide as high has this much
GROUND_LEVEL, ALONE_LEVEL = 0.6, 0.9  # the same for ground with things on it, and without
MIN_HILLY_LEVEL = 0.3  # the same for one sheet of hills with things on it
MAX_TILE_THICKNESS_SHARE = 0.1  # of the tile's width
MAX_GROUND_HEIGHT_SHARE = 0.25  # of the ground's longer side
MIN_GROUND_EXTENT_SHARE = 0.05  # of the scenery's extent, for each piece of ground
MIN_COVERED_SHARE = 0.4  # of the scenery's extent, by all ground
MIN_CARRIED_SHARE = 0.7  # of what is above a piece of ground, and doesn't reach below it
MIN_SCENERY_WIDTH_M = 20.0
MIN_SHEET_WIDTH_M = 20.0  # narrower sheets without a name don't count as water
MIN_FILLED_SHARE = 0.1  # of bounds seen from above; a barrier or a curb around a track is as wide and level
MAX_OPEN_RATIO = 1.5  # of a piece's area seen from above to that of its bounds: a closed mesh has 2
MIN_THING_WIDTH_M = 3.0  # what is on a roof is narrower
MIN_PIT_DEPTH_M = 30.0  # from the lowest point around a pit to the pit's highest
MIN_WATER_DEPTH_M = 0.5  # of ground below such a sheet


def level_share_and_area(mesh: Mesh, meters_from_mesh: Float[np.ndarray, "4 4"]) -> tuple[float, float]:
    """Return the share of a mesh's area that slopes at most 30 degrees, and its faces' square meters from above."""
    corners = transform_points(meters_from_mesh, mesh.vertices)[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.sqrt(np.einsum("ij,ij->i", normal, normal))
    whole, level = float(area.sum()), float(area[np.abs(normal[:, 2]) >= MIN_LEVEL_COSINE * area].sum())
    return (level / whole if whole > 0.0 else 0.0), float(np.abs(normal[:, 2]).sum()) / 2


def is_wide_and_level(piece: Piece, *, least: float) -> bool:
    """Return whether a piece is at least `least` meters wide, no higher than wide, and mostly level."""
    length, width, height = piece.size
    return bool(min(length, width) >= least and height <= max(length, width) and piece.level >= MIN_LEVEL_SHARE)


def is_open_land(piece: Piece) -> bool:
    """Return whether a piece is mostly level, wide, and open below, as land is and vehicles aren't."""
    open_below = MIN_COVERED_SHARE <= piece.filled <= MAX_OPEN_RATIO
    return bool(open_below and piece.level >= GROUND_LEVEL and 2 * piece.size[2] <= min(piece.size[:2]))


def ground_indices_by_shape(pieces: Sequence[Piece], among: Sequence[int], solid: Sequence[Piece]) -> list[int]:
    """Return pieces that are large, level, lowest, and together carry the rest; possibly none."""
    around = enclosing_piece(solid)
    rest = np.array([piece.bounds for piece in solid if piece is not around]).reshape(-1, 2, 3)
    if not len(rest):
        return []
    extent = rest[:, 1].max(axis=0) - rest[:, 0].min(axis=0)
    if max(extent[:2]) < MIN_SCENERY_WIDTH_M:
        return []
    if len(pieces) == len(among) == 1 and is_open_land(pieces[0]):
        return list(among)
    least = MIN_GROUND_EXTENT_SHARE * extent[0] * extent[1]
    able = [i for i in among if _may_be_ground_piece(pieces[i], least)]
    able.sort(key=lambda i: pieces[i].bounds[:, 2].sum())
    taken: list[int] = []
    for i in able:
        over = max((_plan_view_overlap_area(pieces[i].bounds, pieces[j].bounds) for j in taken), default=0.0)
        if over < 0.5 * pieces[i].area and _carries_most_pieces(pieces[i], rest):
            taken.append(i)
    covered = sum(pieces[i].area for i in taken)
    return taken if covered >= MIN_COVERED_SHARE * extent[0] * extent[1] else []


def _may_be_ground_piece(piece: Piece, least: float, *, level: float = GROUND_LEVEL) -> bool:
    low = piece.size[2] <= MAX_GROUND_HEIGHT_SHARE * max(piece.size[:2])
    return bool(low and piece.level >= level and not (piece.scattered or piece.clear) and piece.area >= least)


def _carries_most_pieces(piece: Piece, rest: Float[np.ndarray, "n 2 3"]) -> bool:
    """Return whether most pieces centered above or below a piece don't reach below it; true if it's alone."""
    low, high = piece.bounds
    middle = rest.mean(axis=1)[:, :2]
    there = ((middle >= low[:2]) & (middle <= high[:2])).all(axis=1) & (rest != piece.bounds).any(axis=(1, 2))
    if not there.any():
        return bool(piece.level >= ALONE_LEVEL)
    sunk = np.maximum(1.0, 0.2 * (rest[:, 1, 2] - rest[:, 0, 2]))
    return bool((rest[there, 0, 2] >= low[2] - sunk[there]).mean() >= MIN_CARRIED_SHARE)


def lake_like_sheet_indices(
    pieces: Sequence[Piece], among: Sequence[int], ground: Sequence[Float[np.ndarray, "2 3"]]
) -> list[int]:
    """Return pieces that are wide flat sheets between the lowest and the highest ground, like a lake."""
    if not ground:
        return []
    lowest, highest = min(b[0, 2] for b in ground), max(b[1, 2] for b in ground)
    low = lowest + MIN_WATER_DEPTH_M
    return [i for i in among if _is_wide_sheet(pieces[i]) and low < pieces[i].bounds[:, 2].mean() < highest]


def _is_wide_sheet(piece: Piece) -> bool:
    flat = piece.size[2] <= MAX_SHEET_THICKNESS_SHARE * max(piece.size[:2]) and piece.filled >= MIN_FILLED_SHARE
    return bool(flat and is_wide_and_level(piece, least=MIN_SHEET_WIDTH_M) and not piece.scattered)


def sunken_ground_and_depths(
    among: Sequence[int], pieces: Sequence[Piece], obstacles: Sequence[Piece]
) -> list[tuple[int, float, str]]:
    """Find ground `MIN_PIT_DEPTH_M` below the largest piece around it or all else: its depth, and what's above."""
    if not among:
        return []
    main = pieces[max(among, key=lambda i: pieces[i].area)].bounds
    within = [i for i in among if _plan_view_overlap_area(pieces[i].bounds, main) > 0.9 * pieces[i].area]
    below = [(i, float(main[0, 2] - pieces[i].bounds[1, 2]), "the main ground and under it") for i in within]
    found = {i: (depth, what) for i, depth, what in below if depth > MIN_PIT_DEPTH_M}
    rest = sorted((i for i in among if i not in found), key=lambda i: pieces[i].bounds[1, 2])
    for k, i in enumerate(rest[:-1]):
        lows = [pieces[j].bounds[0, 2] for j in rest[k + 1 :]] + [piece.bounds[0, 2] for piece in obstacles]
        if (depth := float(min(lows) - pieces[i].bounds[1, 2])) <= MIN_PIT_DEPTH_M:
            break
        found[i] = (depth, "everything else")
    return [(i, *how) for i, how in found.items()]


def canopy_sheets_and_heights(pieces: Sequence[Piece], ground: Sequence[Float[np.ndarray, "2 3"]]) -> list[tuple[Piece, float]]:
    """Find flat sheets that hide the sky from much of the ground, and how many meters above its middle they are."""
    if not ground:
        return []
    whole = np.stack([np.min([b[0] for b in ground], axis=0), np.max([b[1] for b in ground], axis=0)])
    least = MIN_COVERED_SHARE * _plan_view_overlap_area(whole, whole)
    wide = [piece for piece in pieces if _is_wide_sheet(piece) and _plan_view_overlap_area(piece.bounds, whole) > least]
    heights = [(piece, float(piece.bounds[:, 2].mean() - whole[:, 2].mean())) for piece in wide]
    return [(piece, above) for piece, above in heights if above > 0.0]


def wide_ground_indices(
    among: Sequence[int], pieces: Sequence[Piece], ground: Sequence[Piece], obstacles: Sequence[Piece]
) -> list[int]:
    """Find wide level meshes that are ground by any name: as wide as the scenery, or under its roads and houses."""
    if not ground:
        return []
    highest = max(piece.bounds[1, 2] for piece in ground)
    whole = np.array([piece.bounds for piece in (*ground, *obstacles)])
    extent = np.ptp(np.stack([whole[:, 0].min(axis=0), whole[:, 1].max(axis=0)]), axis=0)
    between = lake_like_sheet_indices(pieces, among, [piece.bounds for piece in ground])
    known = np.stack([np.min([p.bounds[0] for p in ground], axis=0), np.max([p.bounds[1] for p in ground], axis=0)])
    found = []
    for i in among:
        piece, least = pieces[i], MIN_COVERED_SHARE * extent[0] * extent[1]
        flat = piece.size[2] <= MAX_SHEET_THICKNESS_SHARE * max(piece.size[:2])
        open_below = MIN_COVERED_SHARE <= piece.filled <= MAX_OPEN_RATIO or (flat and piece.filled >= MIN_COVERED_SHARE)
        level = MIN_HILLY_LEVEL if 0.8 <= piece.filled <= 1.2 else GROUND_LEVEL
        wide = _may_be_ground_piece(piece, MIN_SHEET_WIDTH_M**2, level=level)
        if (
            not wide
            or min(piece.size[:2]) < MIN_SHEET_WIDTH_M
            or not open_below
            or i in between
            or piece.bounds[0, 2] > highest + MIN_WATER_DEPTH_M
        ):
            continue
        held = [p for p in obstacles if p is not piece and _is_below_wide_piece(p, piece)]
        here = 2.0 * _plan_view_overlap_area(piece.bounds, known) > piece.area
        carries = here and any(_is_on_wide_piece(p, piece) for p in (*ground, *obstacles))
        if not held and ((piece.area > least and piece.level >= GROUND_LEVEL) or carries):
            found.append(i)
    return found


def ground_tile_indices(
    among: Sequence[int], pieces: Sequence[Piece], ground: Sequence[Piece], obstacles: Sequence[Piece]
) -> list[int]:
    """Find level tiles of one size beside the ground that together cover much of the scenery."""
    if not ground:
        return []
    bounds = np.array([piece.bounds for piece in (*ground, *obstacles)])
    extent = bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)
    low, high = (np.array([piece.bounds[end, 2] for piece in ground]) for end in (0, 1))
    families: dict[tuple[float, ...], list[int]] = {}
    for i in among:
        piece = pieces[i]
        thin = piece.size[2] <= MAX_TILE_THICKNESS_SHARE * max(piece.size[:2])
        beside = low.min() - MIN_WATER_DEPTH_M <= piece.bounds[0, 2] <= high.max() + MIN_WATER_DEPTH_M
        if thin and beside and _may_be_ground_piece(piece, MIN_THING_WIDTH_M**2):
            families.setdefault(tuple(np.round(piece.size, 2).tolist()), []).append(i)
    least = MIN_COVERED_SHARE * extent[0] * extent[1]
    return [i for own in families.values() if sum(pieces[i].area for i in own) > least and len(own) > 1 for i in own]


def _is_below_wide_piece(piece: Piece, wide: Piece) -> bool:
    return bool(
        piece.bounds[0, 2] < wide.bounds[0, 2] - MIN_WATER_DEPTH_M
        and _plan_view_overlap_area(piece.bounds, wide.bounds) > MIN_COVERED_SHARE * wide.area
    )


def _is_on_wide_piece(piece: Piece, wide: Piece) -> bool:
    size, (low, high) = piece.size, wide.bounds
    on_it = _plan_view_overlap_area(piece.bounds, wide.bounds) > 0.9 * piece.area
    bottom = low[2] - MIN_WATER_DEPTH_M <= piece.bounds[0, 2] <= high[2] + MIN_WATER_DEPTH_M
    return bool(max(size[:2]) > MIN_THING_WIDTH_M and piece.area < MIN_COVERED_SHARE * wide.area and on_it and bottom)


def enclosing_piece(pieces: Sequence[Piece]) -> Piece | None:
    """Return the largest piece if it isn't a sheet and all others are inside its bounds, as in a sky dome."""
    if len(pieces) < 2:
        return None
    bounds = np.array([piece.bounds for piece in pieces])
    size = bounds[:, 1] - bounds[:, 0]
    largest = int(np.argmax(size.prod(axis=1)))
    others = np.delete(bounds, largest, axis=0)
    inside = (others[:, 0, :2] >= bounds[largest, 0, :2]).all() and (others[:, 1] <= bounds[largest, 1]).all()
    high = size[largest, 2] > MAX_GROUND_HEIGHT_SHARE * max(size[largest, :2])
    return pieces[largest] if inside and high and pieces[largest].level < GROUND_LEVEL else None


def _plan_view_overlap_area(a: Float[np.ndarray, "2 3"], b: Float[np.ndarray, "2 3"]) -> float:
    return float(np.prod(np.clip(np.minimum(a[1], b[1]) - np.maximum(a[0], b[0]), 0.0, None)[:2]))
