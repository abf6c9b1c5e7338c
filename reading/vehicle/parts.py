"""The turret and the gun among a vehicle's pieces, and their pivots. Doesn't need Blender."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hulldown.geometry.transforms import apply
from hulldown.reading.options import DEFAULTS, Options
from hulldown.reading.roles import Link, Piece
from hulldown.reading.vehicle.nose import snapped
from hulldown.reading.vehicle.part_names import GUN_PART, HULL, TURRET_PART, Key, Namer, key_of
from hulldown.reading.vehicle.part_shapes import by_shape, riding, screened, unnamed
from hulldown.reading.vehicle.pivots import (
    PIVOT_KEYS,
    Pivot,
    cheeks,
    find_pivot,
    gun_guess,
    helper_pivot,
    nodes_of,
    turret_guess,
)
from hulldown.reading.vehicle.solids import Solids, find_solids
from hulldown.reading.wording import quoted

LIMITS = {TURRET_PART: (-np.pi, np.pi), GUN_PART: (float(np.radians(-5.0)), float(np.radians(20.0)))}
STRAIGHT = np.radians(15.0)  # a gun that points this close to an axis of the vehicle points along it
NAMES = 6  # that a sentence lists


@dataclass(frozen=True, eq=False, slots=True)
class Parts:
    """The rigid parts of a vehicle, in the frame of the points they were found from.

    Parameters
    ----------
    names
        ("hull",), ("hull", "turret"), ("hull", "gun") or ("hull", "turret", "gun").
    piece_part
        For each piece the index into `names`.
    parent, pivot, axis, limits
        As in `assets.vehicle.VehicleShape`.
    why
        Source of each part's pivot.
    piece_why
        For each piece the name by which it belongs, or seems to belong, to its part; empty for other parts of the
        hull.
    doubts
        Sentences for the user, with the key to set.
    """

    names: tuple[str, ...]
    piece_part: tuple[int, ...]
    parent: tuple[int, ...]
    pivot: Float[np.ndarray, "p 3"]
    axis: Float[np.ndarray, "p 3"]
    limits: Float[np.ndarray, "p 2"]
    why: tuple[str, ...]
    piece_why: tuple[str, ...]
    doubts: tuple[str, ...] = ()


def find_parts(
    pieces: Sequence[Piece],
    points: Sequence[Float[np.ndarray, "_ 3"]],
    markers: Sequence[tuple[Link, ...]],
    *,
    vehicle_from_file: Float[np.ndarray, "4 4"],
    options: Options = DEFAULTS,
    solids: Solids | None = None,
) -> Parts:
    """The hull, the turret and the gun among the pieces of a vehicle.

    Parameters
    ----------
    pieces
        The vehicle's pieces.
    points
        For each piece its vertices after `vehicle_from_file`.
    markers
        The chains of all empties, any of which may be a part's pivot.
    vehicle_from_file
        From the world of the file to meters, x forward, z up.
    options
        The config's turret, gun, and pivots.
    solids
        Solids of the pieces, in the frame of `points`; without them shapes aren't judged.

    Raises
    ------
    ValueError
        If `options` name a missing pivot.
    """
    solids = find_solids((), ()) if solids is None else solids
    namer, no_guns, doubts = _named(pieces, points, solids, options)
    part_of = [namer.part_of(piece.chain) for piece in pieces]
    names, parents, why = [HULL], [-1], [""]
    pivots, axes, limits = [np.zeros(3)], [np.array([0.0, 0.0, 1.0])], [(0.0, 0.0)]
    piece_part = np.zeros(len(pieces), int)
    bounds = np.array([[p.min(axis=0), p.max(axis=0)] for p in points])
    middle = (bounds[:, 0].min(axis=0) + bounds[:, 1].max(axis=0)) / 2
    resting = [p.chain[0].pose[:3, 3] for p, part in zip(pieces, part_of, strict=True) if part is None]
    middles = {key_of(p.chain[0]): b.mean(axis=0) for p, b in zip(pieces, bounds, strict=True)}
    still = apply(vehicle_from_file, np.array(resting).reshape(-1, 3))
    for name in (TURRET_PART, GUN_PART):
        members = np.array([p == name for p in part_of], bool)
        if not members.any() or members.all():
            continue
        own = np.concatenate([points[i] for i in np.flatnonzero(members)])
        behind = pivots[-1] if len(pivots) > 1 else middle
        pivot = _asked_pivot(name, options, pieces, markers, vehicle_from_file)
        pivot = pivot or helper_pivot(name, pieces, middles)
        if pivot is None:
            guess = _guess(name, own, points, part_of, solids, behind)
            nodes = nodes_of(pieces, markers, members, namer, name)
            pivot = find_pivot(
                nodes,
                own,
                name,
                guess=guess,
                behind=behind,
                middles=middles,
                resting=still,
                vehicle_from_file=vehicle_from_file,
            )
            if pivot.guessed:
                doubts.append(f"the {name} turns about {pivot.why}; set {PIVOT_KEYS[name]} if that is wrong")
        parents.append(names.index(TURRET_PART) if TURRET_PART in names else 0)
        piece_part[members] = len(names)
        names.append(name)
        pivots.append(pivot.at)
        axes.append(_raising_axis(own, pivot.at) if name == GUN_PART else np.array([0.0, 0.0, 1.0]))
        limits.append(LIMITS[name])
        why.append(pivot.why)
    doubts += _missing_parts(names, options, no_guns)
    if names == [HULL] and not doubts and options.turret is None and options.gun is None:
        doubts += unnamed(pieces, bounds, solids)
    decided = [namer.decided(piece.chain) for piece in pieces]
    links = [piece.chain[0] for piece in pieces]
    shape = [next((name for name in (link.name, *link.collections) if name in no_guns), "") for link in links]
    return Parts(
        tuple(names),
        tuple(int(i) for i in piece_part),
        tuple(parents),
        np.array(pivots),
        np.array(axes),
        np.array(limits),
        tuple(why),
        tuple(
            decision[1] if part else f"named {other!r}, but short and not ahead: no gun" if other else ""
            for decision, part, other in zip(decided, piece_part, shape, strict=True)
        ),
        tuple(doubts),
    )


def _named(
    pieces: Sequence[Piece], points: Sequence[Float[np.ndarray, "_ 3"]], solids: Solids, options: Options
) -> tuple[Namer, set[str], list[str]]:
    """What names each piece's part; names like those of guns whose shapes aren't guns'; and doubts."""
    chains = [piece.chain for piece in pieces]
    namer, no_guns = screened(chains, points, options.turret, options.gun)
    doubts: list[str] = []
    part_of = [namer.part_of(chain) for chain in chains]
    aboard = riding(chains, points, part_of) if options.turret is None else []
    marks: dict[Key, tuple[str, str]] = {}
    if aboard:
        marks = {key_of(chains[i][0]): (TURRET_PART, "by its place on the turret") for i in aboard}
        namer = Namer(chains, options.turret, options.gun, no_gun=no_guns, marked=marks)
        part_of = [namer.part_of(chain) for chain in chains]
        those = quoted((chains[i][0].name for i in aboard), most=NAMES)
        doubts.append(
            f"{those} are on the turret and turn with it; if that is wrong, set turret and gun to the parts that turn "
            "and rise"
        )
    if options.gun is None and GUN_PART not in part_of:
        found, shape_doubts = by_shape(pieces, points, solids, part_of, turret_asked=options.turret is not None)
        doubts += shape_doubts
        if found:
            namer = Namer(chains, options.turret, options.gun, no_gun=no_guns, marked=marks | found)
    return namer, no_guns, doubts


def _guess(
    name: str,
    own: Float[np.ndarray, "n 3"],
    points: Sequence[Float[np.ndarray, "_ 3"]],
    part_of: Sequence[str | None],
    solids: Solids,
    behind: Float[np.ndarray, "3"],
) -> Pivot:
    def of(part: str | None) -> Solids:
        return solids.where(np.array([part_of[i] == part for i in solids.piece], bool))

    def cloud(part: str | None) -> Float[np.ndarray, "_ 3"]:
        some = [p for p, its in zip(points, part_of, strict=True) if its == part]
        return np.concatenate(some) if some else own[:0]

    mount = TURRET_PART if TURRET_PART in part_of else None
    gun = cloud(GUN_PART)
    held = cheeks(gun, cloud(mount), of(mount)) if len(gun) else None
    if name == GUN_PART:
        return gun_guess(own, behind, of(GUN_PART), held=held)
    trunnions = gun_guess(gun, behind, of(GUN_PART), held=held).at if len(gun) else None
    under = cloud(None)
    return turret_guess(own, under, of(TURRET_PART), of(None), trunnions=trunnions)


def _asked_pivot(
    name: str,
    options: Options,
    pieces: Sequence[Piece],
    markers: Sequence[tuple[Link, ...]],
    vehicle_from_file: Float[np.ndarray, "4 4"],
) -> Pivot | None:
    """The pivot that the config names, as a point of the file or as an object."""
    wanted = options.turret_pivot if name == TURRET_PART else options.gun_pivot
    if wanted is None:
        return None
    key = PIVOT_KEYS[name]
    if not isinstance(wanted, str):
        return Pivot(apply(vehicle_from_file, np.array(wanted, float)[None])[0], f"the config's {key}")
    for chain in (*markers, *(p.chain for p in pieces)):
        for link in chain:
            if link.name == wanted:
                return Pivot(
                    apply(vehicle_from_file, link.pose[:3, 3][None])[0], f"origin of {wanted!r}, the config's {key}"
                )
    raise ValueError(f"{key} = {wanted!r} is no object or empty of the file")


def _missing_parts(names: Sequence[str], options: Options, no_guns: set[str]) -> list[str]:
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
