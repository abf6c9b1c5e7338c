"""What Blender draws of a file, as plain arrays, and which pieces belong to a vehicle, by names, bounds, and counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from hulldown.geometry.meshes import Mesh
from hulldown.reading.pieces.asset_report import By, ObjectRow
from hulldown.reading.pieces.doubt import Doubt
from hulldown.reading.pieces.naming import (
    HELPER_WORDS,
    PERSON_WORDS,
    PRIMITIVE_WORDS,
    STAGE_WORDS,
    first_matching_pattern,
    name_words,
)

MAX_SHEET_THICKNESS_SHARE = 0.02  # of a sheet's longer side
MAX_STAGE_THICKNESS_SHARE = 0.1  # the same for a possible stage that is called "Plane" and nothing else
MIN_STAGE_REACH_SHARE = 0.1  # of the rest's longer side, by which a stage reaches out of the rest
MAX_SUNK_SHARE = 0.05  # of the rest's height, by which wheels may be sunk into the floor
MIN_STAGE_AREA_RATIO = 4.0  # to the area of the rest's footprint


@dataclass(frozen=True, eq=False, slots=True)
class Link:
    """An object in the chain from a piece up to the root: itself, its parents, then its instancers."""

    name: str
    collections: tuple[str, ...]  # names of the collections it is in, nearest first, then the collections around those
    kind: str  # Blender's object type, such as "MESH" or "EMPTY"
    pose: Float[np.ndarray, "4 4"]  # the object's pose in the world of the file


class Unseen(Enum):
    """Reasons why the camera doesn't see a drawn piece, as a report words them."""

    RAY_VISIBILITY = "invisible to the camera (ray visibility)"
    INDIRECT_ONLY = "invisible to the camera (its collection is indirect only)"
    SHADOW_CATCHER = "a shadow catcher"
    HOLDOUT = "a holdout"
    VOLUME = "has volume shaders only"


@dataclass(frozen=True, eq=False, slots=True)
class Piece:
    """One drawn mesh, or the mesh that replaces hair."""

    data: str  # name of the mesh datablock
    chain: tuple[Link, ...]  # from the drawn object up to the root; never empty
    mesh: int  # index into the file's unique evaluated meshes
    pose: Float[np.ndarray, "4 4"]  # from the mesh's frame to the world of the file
    bounds: Float[np.ndarray, "2 3"]  # in the world of the file, after the file's scale and up axis: meters, z up
    faces: int
    # whether it's instanced by particles, geometry nodes, vertices, or faces, and so doesn't inherit "ground"
    scattered: bool = False
    anonymous: bool = False  # whether geometry nodes made it, so that its object name is its carrier's
    hair: bool = False  # whether it's made of hair curves: grass that hides, and that vehicles drive over
    unseen: Unseen | None = None  # reason why the camera doesn't see it although it's drawn; None if it does
    hidden: bool = False  # whether it's hidden in the viewport but rendered
    carrier: str = ""  # name of the object that instances it; "" if none
    materials: tuple[str, ...] = ()
    clear: bool = False  # whether all of its materials are transparent like water or glass
    # share of its area that is nearly horizontal; 0 if it's too narrow, or too high, to be ground or water
    level: float = 0.0
    filled: float = 1.0  # area of its faces over that of its bounds, seen from above; small for a curb around a track
    look: tuple[object, ...] = ()  # values of `reading.blender.tidy.LOOK_ATTRIBUTES`, for the renderer
    random: float = 0.0  # Cycles' random number of it, which materials may read

    @property
    def name(self) -> str:
        """Name of the drawn object."""
        return self.chain[0].name

    @property
    def size(self) -> Float[np.ndarray, "3"]:
        """Extents of its bounds, in meters."""
        return self.bounds[1] - self.bounds[0]

    @property
    def area(self) -> float:
        """Square meters of its bounds, seen from above."""
        return float(self.size[0] * self.size[1])


@dataclass(eq=False, slots=True)
class Evaluated:
    """The evaluated contents of a scene."""

    # unique evaluated meshes, each in its own frame and the file's units
    meshes: list[Mesh] = field(default_factory=list)
    # the mesh, hair curves, or point cloud of each in Blender, for the renderer
    blocks: list[Any] = field(default_factory=list)
    # by mesh index, the faces whose material is named like water, if only some are
    wet: dict[int, Bool[np.ndarray, " f"]] = field(default_factory=dict)
    # every drawn mesh, where it is drawn; `bounds` after `meters_from_file`
    pieces: list[Piece] = field(default_factory=list)
    markers: list[tuple[Link, ...]] = field(default_factory=list)
    # rows of objects without a piece, and how often they're drawn
    left: Counter[ObjectRow] = field(default_factory=Counter)
    varying: set[str] = field(default_factory=set)  # objects whose shape in Cycles depends on camera or material
    doubts: list[Doubt] = field(default_factory=list)  # sentences about things that are rendered differently than read


@dataclass(frozen=True, slots=True)
class PieceRole:
    """The use of a piece, such as "turret", "ground", or "dropped", the reason in words, and what decided."""

    use: str
    why: str
    by: By = By.SHAPE


def vehicle_roles(pieces: Sequence[Piece], *, keep: Sequence[str] = (), drop: Sequence[str] = ()) -> list[PieceRole]:
    """Return for each piece of a vehicle file whether it's "vehicle" or "dropped", and why."""
    around = [{n for link in piece.chain for n in (link.name, *link.collections)} - {piece.name} for piece in pieces]
    shared = set.intersection(*around) if around else set()  # a parent of all is no helper
    roles: list[PieceRole | None] = [_vehicle_role_by_name(piece, keep, drop, shared) for piece in pieces]
    open_ = [i for i, role in enumerate(roles) if role is None]
    doubtful = [i for i in open_ if _stage_name_and_pattern(pieces[i]) or _is_level_sheet(pieces[i])]
    # Certain pieces give the vehicle's size. The others are judged from the smallest up; kept ones are added.
    doubtful.sort(key=lambda i: pieces[i].area)
    sure = set(open_) - set(doubtful)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i, (piece, role) in enumerate(zip(pieces, roles, strict=True)):
        if i in sure or (role is not None and role.use == "vehicle"):
            low, high = np.minimum(low, piece.bounds[0]), np.maximum(high, piece.bounds[1])
    for i in doubtful:
        # Where all is doubtful the smallest thing is a vehicle if anything is.
        roles[i] = _vehicle_role_by_place(pieces[i], low, high) if (low <= high).all() else None
        if roles[i] is None:
            low, high = np.minimum(low, pieces[i].bounds[0]), np.maximum(high, pieces[i].bounds[1])
    return [role or PieceRole("vehicle", "by default", By.DEFAULT) for role in roles]


def _vehicle_role_by_name(piece: Piece, keep: Sequence[str], drop: Sequence[str], shared: Collection[str]) -> PieceRole | None:
    if piece.unseen:
        return PieceRole("dropped", piece.unseen.value, By.FILE)
    if piece.hair:
        return PieceRole("dropped", "hair isn't part of a vehicle", By.FILE)
    for patterns, use in ((keep, "vehicle"), (drop, "dropped")):
        for name in _names_of_piece_and_parents(piece):
            if pattern := first_matching_pattern(name, patterns):
                key = "keep" if use == "vehicle" else "drop"
                return PieceRole(use, f"{name!r} matches {pattern!r} of the config's {key}", By.CONFIG)
    for name in _names_of_piece_and_parents(piece):
        if name not in shared and (pattern := first_matching_pattern(name, HELPER_WORDS)):
            return PieceRole("dropped", f"{name!r} matches {pattern!r}", By.NAME)
    return None


def _names_of_piece_and_parents(piece: Piece) -> list[str]:
    return list(dict.fromkeys([piece.name, piece.data, *(n for link in piece.chain for n in (link.name, *link.collections))]))


def is_kept_by_name(piece: Piece, keep: Sequence[str]) -> bool:
    """Return whether the config keeps a piece by name."""
    return any(first_matching_pattern(name, keep) for name in _names_of_piece_and_parents(piece))


def _stage_name_and_pattern(piece: Piece) -> tuple[str, str] | None:
    for name in (piece.name, piece.data, *piece.chain[0].collections):
        if pattern := first_matching_pattern(name, (*STAGE_WORDS, *PERSON_WORDS)):
            return name, pattern
    # Many meshes are named "Plane", or "truck_Plane" by exporters, after the primitive they were made from.
    named = [word for word in name_words(piece.name) if not word.isdigit()]
    if named and set(named) <= set(PRIMITIVE_WORDS) and piece.size.min() <= MAX_STAGE_THICKNESS_SHARE * piece.size.max():
        return piece.name, named[0]
    return None


def _is_level_sheet(piece: Piece) -> bool:
    return bool(piece.size[2] <= MAX_SHEET_THICKNESS_SHARE * max(piece.size[:2]))


def _vehicle_role_by_place(piece: Piece, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> PieceRole | None:
    size, height = float(max(high[:2] - low[:2])), float(high[2] - low[2])
    under = bool(piece.bounds[1, 2] <= low[2] + MAX_SUNK_SHARE * height)
    if named := _stage_name_and_pattern(piece):
        out = float(max(np.max(low[:2] - piece.bounds[0, :2]), np.max(piece.bounds[1, :2] - high[:2])))
        if out > MIN_STAGE_REACH_SHARE * size:
            return PieceRole("dropped", f"{named[0]!r} matches {named[1]!r} and reaches {out:.1f} m beyond the rest")
        if under:
            return PieceRole("dropped", f"{named[0]!r} matches {named[1]!r} and is at the underside of the rest")
    larger = piece.area / max(float(np.prod(high[:2] - low[:2])), 1e-12)
    if under and larger > MIN_STAGE_AREA_RATIO and _is_level_sheet(piece):
        return PieceRole("dropped", f"a flat sheet {larger:.0f} times as large as the rest, lying under it")
    return None
