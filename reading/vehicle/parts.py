"""The turret and the gun among a vehicle's pieces, and their pivots. Doesn't need Blender."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hulldown.reading.options import DEFAULTS, Options
from hulldown.reading.report import PartRow, xyz
from hulldown.reading.vehicle.nose import snapped
from hulldown.reading.vehicle.part_names import GUN_PART, HULL, TURRET_PART, Naming
from hulldown.reading.vehicle.part_shapes import by_shape, riding, screened, unnamed
from hulldown.reading.vehicle.pivots import PIVOT_KEYS, find_pivot
from hulldown.reading.vehicle.solids import PlacedPieces
from hulldown.reading.wording import quoted

LIMITS = {TURRET_PART: (-np.pi, np.pi), GUN_PART: (float(np.radians(-5.0)), float(np.radians(20.0)))}
STRAIGHT = np.radians(15.0)  # a gun that points this close to an axis of the vehicle points along it


@dataclass(frozen=True, eq=False, slots=True)
class Parts:
    """The rigid parts of a vehicle.

    Parameters
    ----------
    moving
        The turret, if there is one, then the gun; pivots and axes in the frame of the pieces.
    piece_part
        For each piece the number of its part: 0 for the hull, 1 for the first that moves.
    piece_why
        For each piece the name by which it belongs, or seems to belong, to its part; empty for other parts of the
        hull.
    doubts
        Sentences for the user, with the key to set.
    """

    moving: tuple[PartRow, ...]
    piece_part: tuple[int, ...]
    piece_why: tuple[str, ...]
    doubts: tuple[str, ...]


def find_parts(whole: PlacedPieces, options: Options = DEFAULTS) -> Parts:
    """The hull, the turret and the gun among the pieces of a vehicle, by the config's turret, gun, and pivots.

    Raises
    ------
    ValueError
        If `options` name a missing pivot.
    """
    naming, doubts = _named(whole, options)
    decided = [naming.decided(piece.chain) for piece in whole.pieces]
    part_of = [part for part, _, _ in decided]
    moving: list[PartRow] = []
    piece_part = np.zeros(len(whole.pieces), int)
    bounds = whole.bounds
    behind = (bounds[:, 0].min(axis=0) + bounds[:, 1].max(axis=0)) / 2
    for name in (TURRET_PART, GUN_PART):
        members = np.array([part == name for part in part_of], bool)
        if not members.any() or members.all():
            continue
        pivot = find_pivot(whole, naming, name, part_of=part_of, behind=behind, options=options)
        if pivot.guessed:
            doubts.append(f"the {name} turns about {pivot.why}; set {PIVOT_KEYS[name]} if that is wrong")
        behind = pivot.at
        axis = np.array([0.0, 0.0, 1.0])
        if name == GUN_PART:
            axis = _raising_axis(whole.where(members).cloud, pivot.at)
        parent = moving[0].name if moving else HULL
        moving.append(PartRow(name, parent, xyz(pivot.at), xyz(axis), LIMITS[name], pivot.why))
        piece_part[members] = len(moving)
    doubts += _missing_parts([row.name for row in moving], options, naming.no_gun)
    if not moving and not doubts and options.turret is None and options.gun is None:
        doubts += unnamed(whole)
    links = [piece.chain[0] for piece in whole.pieces]
    shape = [next((name for name in (link.name, *link.collections) if name in naming.no_gun), "") for link in links]
    return Parts(
        tuple(moving),
        tuple(int(i) for i in piece_part),
        tuple(
            why if part else f"named {other!r}, but short and not ahead: no gun" if other else ""
            for (_, why, _), part, other in zip(decided, piece_part, shape, strict=True)
        ),
        tuple(doubts),
    )


def _named(whole: PlacedPieces, options: Options) -> tuple[Naming, list[str]]:
    """What names each piece's part, and doubts."""
    naming, doubts = screened(whole, options), list[str]()
    for find in (riding, by_shape):
        marked, more = find(whole, [naming.part_of(piece.chain) for piece in whole.pieces], options)
        naming = replace(naming, marked={**naming.marked, **marked})
        doubts += more
    return naming, doubts


def _missing_parts(names: Sequence[str], options: Options, no_guns: Collection[str]) -> list[str]:
    """Doubts about a turret without a gun, or a gun without a turret, unless the config confirms it."""
    if TURRET_PART in names and GUN_PART not in names and options.gun is None:
        those = f" ({quoted(sorted(no_guns), most=3)} are shaped like drums)" if no_guns else ""
        return [f'it has a turret but no gun was found{those}; set gun to its name, or to "" if it has none']
    if GUN_PART in names and TURRET_PART not in names and options.turret is None:
        return ['it has a gun but no turret was found; set turret to its name, or to "" if it has none']
    return []


def _raising_axis(own: Float[np.ndarray, "n 3"], pivot: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The horizontal axis about which positive angles raise the part that extends from the pivot."""
    out = own[:, :2] - pivot[:2]
    reach = np.linalg.norm(out, axis=1)
    tip = out[reach >= 0.95 * reach.max()].mean(axis=0)
    angle = snapped(float(np.arctan2(tip[1], tip[0])), STRAIGHT)
    # Rounded, so that an axis of the vehicle comes out as exactly that.
    return np.round([np.sin(angle), -np.cos(angle), 0.0], 15) + 0.0
