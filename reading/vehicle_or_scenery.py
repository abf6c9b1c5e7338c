"""Tell vehicles from sceneries by their contents, and refuse config entries that are probably mistakes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hulldown.base.errors import AssetError
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.naming import VEHICLE_PART_WORDS, first_matching_pattern
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import MAX_SHEET_THICKNESS_SHARE, Piece, vehicle_roles
from hulldown.reading.scenery.scenery_roles import scenery_roles
from hulldown.reading.scenery.shape import is_open_land

MAX_GROUNDED_VEHICLE_M = 30.0  # larger files with ground count as sceneries


def likely_kind(pieces: Sequence[Piece], options: Options) -> str:
    """Return "scenery" for ground with things wider than a vehicle, or for a flat, wide file; else "vehicle"."""
    if not pieces:
        return "vehicle"
    if not _ground_pieces(pieces, options):
        length, width, height = _pieces_extent(pieces)
        across = max(length, width)
        sheet = height <= MAX_SHEET_THICKNESS_SHARE * across or (len(pieces) == 1 and is_open_land(pieces[0]))
        return "scenery" if across > MAX_GROUNDED_VEHICLE_M and sheet else "vehicle"
    kept = _vehicle_pieces(pieces)
    if 2 * sum(bool(first_matching_pattern(p.name, VEHICLE_PART_WORDS)) for p in kept) > len(kept):
        return "vehicle"  # in other units: its hull, or its tracks, may be taken for ground
    return "scenery" if not kept or max(_pieces_extent(kept)) > MAX_GROUNDED_VEHICLE_M else "vehicle"


def refuse_or_doubt_kind(kind: str, pieces: Sequence[Piece], options: Options) -> Doubt | None:
    """Refuse a file of the other kind, unless options describe it; return a doubt if it may be intended."""
    if not pieces:
        return None
    if kind == "vehicle":
        if options.scale or options.keep or options.drop or likely_kind(pieces, options) == "vehicle":
            return None
        kept = _vehicle_pieces(pieces)
        if any(first_matching_pattern(p.name, VEHICLE_PART_WORDS) for p in kept):
            return None  # a tank in centimeters has tracks, which are called like ground: `doubts` names the scale
        ground = _ground_pieces(pieces, options)
        has = f"ground ({ground[0].name!r})" if ground else "one flat sheet"
        raise AssetError(
            f"looks like a scenery but is listed as a vehicle: it contains {has}, and the rest is "
            f"{max(_pieces_extent(kept or pieces)):,.0f} m long",
            remedy="list it under [[assets.sceneries]], or name the vehicle's objects in `keep`, or set its `scale`",
        )
    overrides = (options.scale, options.ground, options.not_ground, options.drop)
    if any(overrides) or likely_kind(pieces, options) == "scenery":
        return None
    telling = next((p.name for p in pieces if first_matching_pattern(p.name, VEHICLE_PART_WORDS)), None)
    longest = max(_pieces_extent(_vehicle_pieces(pieces) or pieces))
    if longest > MAX_GROUNDED_VEHICLE_M:
        return None
    if telling:
        raise AssetError(
            f"looks like a vehicle but is listed as a scenery: it contains {telling!r}, and it is {longest:.1f} m long",
            remedy="list it under [[assets.vehicles]], or name its ground by `ground`",
        )
    if not _ground_pieces(pieces, options):
        text = f"it is {longest:.1f} m long, as a vehicle is; list it under [[assets.vehicles]] if it is one"
        return Doubt(DoubtKind.OTHER_KIND, text)
    return None


def _ground_pieces(pieces: Sequence[Piece], options: Options) -> list[Piece]:
    return [p for p, role in zip(pieces, scenery_roles(pieces, options), strict=True) if role.use == "ground"]


def _vehicle_pieces(pieces: Sequence[Piece]) -> list[Piece]:
    return [p for p, role in zip(pieces, vehicle_roles(pieces), strict=True) if role.use == "vehicle"]


def _pieces_extent(pieces: Sequence[Piece]) -> tuple[float, float, float]:
    bounds = np.array([p.bounds for p in pieces])
    length, width, height = (bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)).tolist()
    return length, width, height
