"""Classify a scenery's pieces as ground, water, obstacle, or sky, by config, name, material, or shape."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase

import numpy as np

from hulldown.reading.pieces.asset_report import By
from hulldown.reading.pieces.naming import (
    BACKDROP_WORDS,
    GROUND_WORDS,
    NOT_GROUND,
    NOT_WATER,
    WATER_BODY_WORDS,
    WATER_WORDS,
    first_matching_pattern,
)
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Piece, PieceRole, Unseen
from hulldown.reading.scenery.shape import (
    ground_indices_by_shape,
    ground_tile_indices,
    is_wide_and_level,
    lake_like_sheet_indices,
    sunken_ground_and_depths,
    wide_ground_indices,
)

MIN_WATER_WIDTH_M = 1.0  # for water by its name or material
# The scenery's keys in the order in which they are asked.
ROLE_KEYS = (("drop", "removed"), ("water", "water"), ("not_ground", "obstacle"), ("ground", "ground"))
_DRY_WORDS = (*NOT_WATER, *GROUND_WORDS, *(word for word in NOT_GROUND if word not in ("water", "cover", "asset", "prop")))


def scenery_roles(pieces: Sequence[Piece], options: Options) -> list[PieceRole]:
    """Return the use of each piece of a scenery, and the reason (paper, section 2.1.5)."""
    decided: dict[tuple, PieceRole] = {}  # a forest is decided tree by tree, but only once
    roles = []
    for piece in pieces:
        asked = (
            *(piece.name, piece.data, piece.chain[0].collections, piece.carrier, piece.materials),
            *(piece.scattered, piece.anonymous, piece.hair, piece.unseen, is_wide_and_level(piece, least=MIN_WATER_WIDTH_M)),
        )
        if asked not in decided:
            decided[asked] = _piece_role(piece, options)
        roles.append(decided[asked])
    if not any(role.use == "ground" for role in roles):
        open_ = [i for i, role in enumerate(roles) if role.use == "obstacle" and role.by is not By.CONFIG]
        solid = [p for p, role in zip(pieces, roles, strict=True) if role.use == "obstacle" and not p.hair]
        for i in ground_indices_by_shape(pieces, open_, solid):
            roles[i] = PieceRole("ground", "by shape: large, level, and under the rest")
    used = {use: [p for p, role in zip(pieces, roles, strict=True) if role.use == use] for use in ("ground", "obstacle")}
    unsure = [role.use == "obstacle" and role.by in (By.NAME, By.DEFAULT) for role in roles]
    open_ = [i for i in np.flatnonzero(unsure).tolist() if not is_water_name(pieces[i].name)]
    solid = [piece for piece in used["obstacle"] if not piece.hair]
    wide = wide_ground_indices(open_, pieces, used["ground"], solid)
    tiles = ground_tile_indices([i for i in open_ if i not in wide], pieces, used["ground"], solid)
    for found, why in ((wide, "wide, level, and under other things"), (tiles, "level tiles beside the ground")):
        for i in found:
            named = f", though its {roles[i].why}" if roles[i].by is By.NAME else ""
            roles[i] = PieceRole("ground", f"by shape: {why}{named}")
    ground = [i for i, role in enumerate(roles) if role.use == "ground"]
    solid = [p for p, role in zip(pieces, roles, strict=True) if role.use == "obstacle" and not p.hair]
    for i, depth, above in sunken_ground_and_depths(ground, pieces, solid):
        if roles[i].by is not By.CONFIG:
            roles[i] = PieceRole("obstacle", f"by shape: {depth:.0f} m below {above}; to use it, name it in ground")
    if options.water is None:
        heights = [p.bounds for p, role in zip(pieces, roles, strict=True) if role.use == "ground"]
        open_ = [i for i, role in enumerate(roles) if role.use == "obstacle" and role.by is By.DEFAULT]
        for i in lake_like_sheet_indices(pieces, open_, heights):
            roles[i] = PieceRole("water", "by shape: a flat sheet with ground below it and above it")
    return roles


def unmatched_key_and_pattern(pieces: Sequence[Piece], options: Options) -> tuple[str, str] | None:
    """Return the first key and pattern of a scenery that match nothing; None if all match."""
    for key, _ in ROLE_KEYS:
        for pattern in getattr(options, key) or ():
            drawn = any(piece.carrier and _is_whole_name_match(piece.carrier, pattern) for piece in pieces) and key == "drop"
            if not drawn and not any(matching_name_and_pattern(piece, (pattern,)) for piece in pieces):
                return key, pattern
    return None


def matching_name_and_pattern(piece: Piece, patterns: Sequence[str]) -> tuple[str, str, str] | None:
    """Return the first pattern that matches a piece: the kind of name, the name, and the pattern."""
    names = {
        "object": (piece.name,),
        "mesh": (piece.data,),
        "collection": piece.chain[0].collections,
        "material": piece.materials,
    }
    for pattern in patterns:
        if _is_whole_name_match(piece.name, pattern):
            return "object", piece.name, pattern
        level, colon, rest = pattern.partition(":")
        if colon and level in names:
            for name in names[level]:
                if _is_whole_name_match(name, rest):
                    return level, name, pattern
    return None


def _is_whole_name_match(name: str, pattern: str) -> bool:
    name, pattern = name.lower(), pattern.lower()
    return name == pattern or (any(c in pattern for c in "*?[") and fnmatchcase(name, pattern))


def _piece_role(piece: Piece, options: Options) -> PieceRole:
    asked = _role_by_config(piece, options)
    if asked and (asked.use == "removed" or (asked.use == "water" and piece.unseen is Unseen.VOLUME)):
        return asked
    if piece.unseen:
        water = _water_role(piece) if piece.unseen is Unseen.VOLUME and options.water is None else None
        return water or PieceRole("dropped", piece.unseen.value, By.FILE)
    if piece.hair:
        return PieceRole("obstacle", "hair: it hides, and gives way to vehicles and cameras", By.FILE)
    if asked:
        return asked
    named = [("object", piece.name), ("mesh", piece.data), *(("collection", c) for c in piece.chain[0].collections)]
    for level, name in named:
        if level != "collection" and (pattern := first_matching_pattern(name, BACKDROP_WORDS)):
            return PieceRole("backdrop", f"{level} {name!r} matches {pattern!r}", By.NAME)
    if options.water is None and (water := _water_role(piece)):
        return water
    for level, name in named:
        # A scattered tree isn't ground, although the ground carries it or its collection is "terrain".
        if piece.scattered and (level == "collection" or (level == "object" and piece.anonymous)):
            continue
        if pattern := first_matching_pattern(name, NOT_GROUND):
            return PieceRole("obstacle", f"{level} {name!r} matches {pattern!r}", By.NAME)
        if pattern := first_matching_pattern(name, GROUND_WORDS):
            return PieceRole("ground", f"{level} {name!r} matches {pattern!r}", By.NAME)
    return PieceRole("obstacle", "by default", By.DEFAULT)


def _role_by_config(piece: Piece, options: Options) -> PieceRole | None:
    if piece.carrier and any(_is_whole_name_match(piece.carrier, pattern) for pattern in options.drop):
        return PieceRole("removed", f"it is drawn by {piece.carrier!r}, which the scenery's `drop` names", By.CONFIG)
    for key, use in ROLE_KEYS:
        if use == "ground" and piece.anonymous:
            continue  # its only name is that of the ground that carries it
        if found := matching_name_and_pattern(piece, getattr(options, key) or ()):
            level, name, pattern = found
            return PieceRole(use, f"{level} {name!r} matches {pattern!r} of the scenery's {key}", By.CONFIG)
    return None


def is_water_name(name: str) -> bool:
    """Return whether a name means water, rather than something in or near it."""
    return (
        not first_matching_pattern(name, _DRY_WORDS)
        and first_matching_pattern(name, (*WATER_WORDS, *WATER_BODY_WORDS)) is not None
    )


def _water_role(piece: Piece) -> PieceRole | None:
    if not is_wide_and_level(piece, least=MIN_WATER_WIDTH_M):
        return None
    own = [("object", piece.name), ("mesh", piece.data)]
    own = own[2 * piece.anonymous :]  # such a piece has its carrier's name
    if any(first_matching_pattern(name, _DRY_WORDS) for _, name in own):
        return None
    materials = [("material", name) for name in piece.materials]
    around = [("collection", name) for name in piece.chain[0].collections[:1] if not piece.scattered]
    for candidates, words in ((own + materials, (*WATER_WORDS, *WATER_BODY_WORDS)), (around, WATER_WORDS)):
        for level, name in candidates:
            if not first_matching_pattern(name, _DRY_WORDS) and (pattern := first_matching_pattern(name, words)):
                return PieceRole("water", f"{level} {name!r} matches {pattern!r}, and it is wide and level", By.NAME)
    clear = piece.clear and not piece.unseen and not any(first_matching_pattern(name, _DRY_WORDS) for _, name in materials)
    if clear and is_wide_and_level(piece, least=5.0):
        return PieceRole("water", "its material is transparent, and it is wide and level", By.FILE)
    return None
