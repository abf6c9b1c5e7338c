"""Which pieces of a vehicle are turret and gun, and about what they turn. Knows names and places, not Blender."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from assets.naming import BODY, FRONT, REAR, VEHICLE, says
from geometry.transforms import apply
from reading.axes import gun_barrel
from reading.part_names import GUN_PART, HULL, TURRET_PART, Key, Namer, key_of
from reading.pivots import PIVOT_KEYS, Pivot, find_pivot, gun_guess, nodes_of, turret_guess
from reading.roles import Link, Piece
from reading.solids import Solids, no_solids

LIMITS = {TURRET_PART: (-np.pi, np.pi), GUN_PART: (float(np.radians(-5.0)), float(np.radians(20.0)))}
STRAIGHT = np.radians(15.0)  # a gun that points this close to an axis of the vehicle points along it
STUBBY = 2.5  # times its width; what is shorter points nowhere
SMALL = 0.2  # of the vehicle's length: a drum, not a gun
NARROW = 0.45  # of the vehicle's width: what a gun with all that hangs on it is
LOW = 0.3  # of the vehicle's height: no turret reaches below
KNOWN = (*VEHICLE, *FRONT, *REAR, *BODY)
NAMES = 6  # that a sentence lists
PREFIXED = 2  # objects named turret: more of them, and the author has named all that belongs to it
WHOLE = 0.7  # of a piece's length: then the piece is the barrel, and not a body with a barrel


@dataclass(frozen=True, slots=True)
class Asked:
    """What the config says of parts: patterns ("" for none), and pivots as names or points in the file's axes."""

    turret: str | None = None
    gun: str | None = None
    turret_pivot: str | tuple[float, float, float] | None = None
    gun_pivot: str | tuple[float, float, float] | None = None


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
        For each part where its pivot comes from.
    piece_why
        For each piece the name by which it belongs to its part, or by which it seems to; empty for other parts of the
        hull.
    doubts
        What a person should look at, a sentence each, with the key to set.
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
    asked: Asked = Asked(),
    solids: Solids | None = None,
) -> Parts:
    """The hull, the turret and the gun among the pieces of a vehicle.

    Parameters
    ----------
    pieces
        Those that belong to the vehicle.
    points
        For each piece its vertices after `vehicle_from_file`.
    markers
        The chains of all empties, any of which may be a part's pivot.
    vehicle_from_file
        From the world of the file to metres, x forward, z up.
    asked
        What the config says.
    solids
        Of the pieces, in the frame of `points`; without them nothing is judged by shape.

    Raises
    ------
    ValueError
        If `asked` names a pivot that is not there.
    """
    chains = [p.chain for p in pieces]
    solids = no_solids() if solids is None else solids
    namer, no_guns = _screened(chains, points, asked)
    doubts: list[str] = []
    part_of = [namer.part_of(chain) for chain in chains]
    riding = _riding(chains, points, part_of) if asked.turret is None else []
    if riding:
        marks = {key_of(chains[i][0]): (TURRET_PART, "by its place on the turret") for i in riding}
        namer = Namer(chains, asked.turret, asked.gun, no_gun=no_guns, marked=marks)
        part_of = [namer.part_of(chain) for chain in chains]
        those = ", ".join(repr(chains[i][0].name) for i in riding[:NAMES])
        doubts.append(f"{those} turn with the turret, which they stand on; name what turns and rises by turret and gun if that is wrong")
    if asked.gun is None and GUN_PART not in part_of:
        marks, said = _by_shape(pieces, points, solids, part_of, asked)
        doubts += said
        if marks:
            namer = Namer(chains, asked.turret, asked.gun, no_gun=no_guns, marked=marks)
            part_of = [namer.part_of(chain) for chain in chains]
    names, parents, why = [HULL], [-1], [""]
    pivots, axes, limits = [np.zeros(3)], [np.array([0.0, 0.0, 1.0])], [(0.0, 0.0)]
    piece_part = np.zeros(len(pieces), int)
    bounds = np.array([[p.min(axis=0), p.max(axis=0)] for p in points])
    middle = (bounds[:, 0].min(axis=0) + bounds[:, 1].max(axis=0)) / 2
    resting = [p.chain[0].pose[:3, 3] for p, part in zip(pieces, part_of, strict=True) if part is None]
    still = apply(vehicle_from_file, np.array(resting).reshape(-1, 3))
    for name in (TURRET_PART, GUN_PART):
        mine = np.array([p == name for p in part_of], bool)
        if not mine.any() or mine.all():
            continue
        own = np.concatenate([points[i] for i in np.flatnonzero(mine)])
        behind = pivots[-1] if len(pivots) > 1 else middle
        pivot = _asked_pivot(name, asked, pieces, markers, vehicle_from_file)
        if pivot is None:
            guess = _guess(name, own, points, part_of, solids, behind)
            nodes = nodes_of(pieces, markers, mine, namer, name)
            pivot = find_pivot(
                nodes, own, name, guess=guess, behind=behind, resting=still, vehicle_from_file=vehicle_from_file
            )
            if pivot.guessed:
                doubts.append(f"the {name} turns about {pivot.why}; set {PIVOT_KEYS[name]} if that is wrong")
        parents.append(names.index(TURRET_PART) if TURRET_PART in names else 0)
        piece_part[mine] = len(names)
        names.append(name)
        pivots.append(pivot.at)
        axes.append(_raising_axis(own, pivot.at) if name == GUN_PART else np.array([0.0, 0.0, 1.0]))
        limits.append(LIMITS[name])
        why.append(pivot.why)
    doubts += _missing_parts(names, asked, no_guns)
    if names == [HULL] and not doubts and asked.turret is None and asked.gun is None:
        doubts += _unnamed(pieces, bounds)
    decided = [namer.decided(chain) for chain in chains]
    shape = [next((n for n in (c[0].name, *c[0].collections) if n in no_guns), "") for c in chains]
    return Parts(
        tuple(names),
        tuple(int(i) for i in piece_part),
        tuple(parents),
        np.array(pivots),
        np.array(axes),
        np.array(limits),
        tuple(why),
        tuple(
            said[1] if part else f"named {other!r}, but short and not ahead: no gun" if other else ""
            for said, part, other in zip(decided, piece_part, shape, strict=True)
        ),
        tuple(doubts),
    )


def _screened(
    chains: Sequence[tuple[Link, ...]], points: Sequence[Float[np.ndarray, "_ 3"]], asked: Asked
) -> tuple[Namer, set[str]]:
    """A namer for which nothing is a gun that is shaped like a drum, and the names of such."""
    no_guns: set[str] = set()
    while True:
        namer = Namer(chains, asked.turret, asked.gun, no_gun=no_guns)
        if asked.gun is not None:
            return namer, no_guns
        mine = [i for i, chain in enumerate(chains) if namer.part_of(chain) == GUN_PART]
        rest = [points[i] for i in range(len(chains)) if i not in set(mine)]
        if not mine or not rest:
            return namer, no_guns
        body = np.concatenate(rest)
        drums: set[str] = set()
        for group in _clusters([points[i] for i in mine]):
            if _is_drum(np.concatenate([points[mine[k]] for k in group]), body):
                drums |= {namer.decided(chains[mine[k]])[2] for k in group}
        if not drums:
            return namer, no_guns
        no_guns |= drums


def _clusters(clouds: Sequence[Float[np.ndarray, "_ 3"]]) -> list[list[int]]:
    """Which of them come close to one another, directly or by others."""
    groups: list[list[int]] = []
    for i, cloud in enumerate(clouds):
        near = [g for g in groups if any(_touch(clouds[k], cloud) for k in g)]
        groups = [g for g in groups if g not in near] + [[k for g in near for k in g] + [i]]
    return groups


def _is_drum(own: Float[np.ndarray, "n 3"], body: Float[np.ndarray, "m 3"]) -> bool:
    """Small beside the vehicle, and stubby or lying across, and behind its middle or low."""
    low, high = body.min(axis=0), body.max(axis=0)
    off = own - own.mean(axis=0)
    axes = np.linalg.eigh(off.T @ off)[1].T[::-1]
    size = np.ptp(off @ axes.T, axis=0)
    if not 0 < size[0] < SMALL * (high[0] - low[0]):
        return False
    stubby = size[0] < STUBBY * size[1:].max()
    across = abs(axes[0, 0]) < 0.5
    middle = (own.min(axis=0) + own.max(axis=0)) / 2
    return bool((stubby or across) and (middle[0] < (low[0] + high[0]) / 2 or middle[2] < low[2] + 0.5 * (high - low)[2]))


def _touch(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "m 3"]) -> bool:
    """Whether the boxes around both come close."""
    slack = 0.05 * max(float(np.ptp(a, axis=0).max()), float(np.ptp(b, axis=0).max()))
    return bool((a.min(axis=0) < b.max(axis=0) + slack).all() and (a.max(axis=0) > b.min(axis=0) - slack).all())


def _by_shape(
    pieces: Sequence[Piece],
    points: Sequence[Float[np.ndarray, "_ 3"]],
    solids: Solids,
    part_of: Sequence[str | None],
    asked: Asked,
) -> tuple[dict[Key, tuple[str, str]], list[str]]:
    """What is gun, and turret if none is named, by a barrel's shape and by what it hangs from; and doubts."""
    bounds = np.array([[p.min(axis=0), p.max(axis=0)] for p in points])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    wide = np.ptp(bounds[:, :, 0], axis=1) < 0.9 * (high - low)[0]
    body = bounds[wide] if wide.any() else bounds
    middle = (body[:, 0].min(axis=0) + body[:, 1].max(axis=0)) / 2
    barrel = gun_barrel(solids, np.array([1.0, 0, 0]), middle, float((high - low)[0]) / 2, [False] * len(pieces))
    if barrel is None:
        return {}, []
    piece = int(solids.piece[barrel])
    name = pieces[piece].name
    one = float(np.ptp(points[piece], axis=0).max()) * WHOLE < float(solids.size[barrel, 0])
    if not one:
        doubt = f"{name!r} has a long barrel in it that cannot be raised; make it an object of its own, or set gun = \"\""
        return {}, [doubt + ('' if TURRET_PART in part_of else ' and turret = ""')]
    carried: dict[Key, list[int]] = {}
    for i, p in enumerate(pieces):
        for link in p.chain:
            carried.setdefault(key_of(link), []).append(i)

    def extent(link: Link) -> Float[np.ndarray, "2 3"]:
        some = bounds[carried[key_of(link)]]
        return np.array([some[:, 0].min(axis=0), some[:, 1].max(axis=0)])

    chain = pieces[piece].chain
    narrow = [k for k in chain if np.ptp(extent(k), axis=0)[1] < NARROW * (high - low)[1]]
    gun = narrow[-1] if narrow else chain[0]
    marks = {key_of(gun): (GUN_PART, f"by the shape of {name!r}")}
    taken = f"{gun.name!r} is taken for the gun by its shape"
    if TURRET_PART not in part_of and asked.turret is None:
        upper = [
            k
            for k in chain
            if extent(k)[0, 2] > low[2] + LOW * (high - low)[2]
            and len(carried[key_of(k)]) > len(carried[key_of(gun)])
        ]
        if not upper:
            return {}, [f"{name!r} looks like a gun; set gun, and turret, to what turns, or both to \"\" if nothing does"]
        marks[key_of(upper[-1])] = (TURRET_PART, f"by its gun {name!r}")
        taken += f", and {upper[-1].name!r} for the turret, which it hangs from"
    return marks, [f"{taken}; set gun and turret if that is wrong"]


def _riding(
    chains: Sequence[tuple[Link, ...]], points: Sequence[Float[np.ndarray, "_ 3"]], part_of: Sequence[str | None]
) -> list[int]:
    """What stands on a turret that nothing hangs from: its author has left out the hierarchy."""
    mine = [i for i, part in enumerate(part_of) if part == TURRET_PART]
    if not mine or any(len(chains[i]) > 1 and chains[i][1].kind == "MESH" for i in mine):
        return []
    roots = {key_of(chains[i][-1]) if len(chains[i]) > 1 else None for i in mine}
    parents = [key_of(chains[i][1]) if len(chains[i]) > 1 else None for i in range(len(chains))]
    if len(roots) > 1 or len({parents[i] for i in mine}) > 1:
        return []
    if len(mine) > PREFIXED:
        return []
    turret = np.concatenate([points[i] for i in mine])
    low, high = turret.min(axis=0), turret.max(axis=0)
    slack = 0.15 * (high - low)
    found = []
    for i, part in enumerate(part_of):
        if part is not None or parents[i] != parents[mine[0]]:
            continue
        own_low, own_high = points[i].min(axis=0), points[i].max(axis=0)
        middle = (own_low + own_high) / 2
        over = bool(((middle > low - slack) & (middle < high + slack))[:2].all()) and middle[2] > low[2] + slack[2]
        if over and own_low[2] > low[2] - slack[2] and (own_high - own_low)[1] < 1.3 * (high - low)[1]:
            found.append(i)
    return found


def _unnamed(pieces: Sequence[Piece], bounds: Float[np.ndarray, "k 2 3"]) -> list[str]:
    """A doubt where names say nothing at all, or where something hangs together above the rest."""
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    carried: dict[Key, list[int]] = {}
    names: dict[Key, str] = {}
    for i, piece in enumerate(pieces):
        for link in piece.chain:
            carried.setdefault(key_of(link), []).append(i)
            names[key_of(link)] = link.name
    upper = [
        key
        for key, some in carried.items()
        if 1 < len(some) < len(pieces) and bounds[some, 0, 2].min() > low[2] + LOW * (high - low)[2]
    ]
    if upper:
        most = max(upper, key=lambda key: len(carried[key]))
        return [
            f"{len(carried[most])} objects hang from {names[most]!r} above the rest; if it turns, set turret to it, and "
            f'gun to what rises; if nothing does, set turret = ""'
        ]
    if len(pieces) > 1 and not any(says(n, KNOWN) for p in pieces for n in (p.name, p.data)):
        return ['its names say nothing; set turret and gun if it has any, or turret = ""']
    return []


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

    if name == GUN_PART:
        return gun_guess(own, behind, of(GUN_PART))
    gun = [p for p, part in zip(points, part_of, strict=True) if part == GUN_PART]
    trunnions = gun_guess(np.concatenate(gun), behind, of(GUN_PART)).at if gun else None
    hull = [p for p, part in zip(points, part_of, strict=True) if part is None]
    under = np.concatenate(hull) if hull else own[:0]
    return turret_guess(own, under, of(TURRET_PART), of(None), trunnions=trunnions)


def _asked_pivot(
    name: str,
    asked: Asked,
    pieces: Sequence[Piece],
    markers: Sequence[tuple[Link, ...]],
    vehicle_from_file: Float[np.ndarray, "4 4"],
) -> Pivot | None:
    """The pivot that the config names, as a point of the file or as an object."""
    wanted = asked.turret_pivot if name == TURRET_PART else asked.gun_pivot
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


def _missing_parts(names: Sequence[str], asked: Asked, no_guns: set[str]) -> list[str]:
    """A turret without a gun, or a gun without a turret, where the config does not say that this is so."""
    if TURRET_PART in names and GUN_PART not in names and asked.gun is None:
        those = f" ({', '.join(map(repr, sorted(no_guns)[:3]))} are shaped like drums)" if no_guns else ""
        return [f'it has a turret but no gun was found{those}; set gun to its name, or to "" if it has none']
    if GUN_PART in names and TURRET_PART not in names and asked.turret is None:
        return ['it has a gun but no turret was found; set turret to its name, or to "" if it has none']
    return []


def _raising_axis(own: Float[np.ndarray, "n 3"], pivot: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The horizontal axis about which positive angles raise what sticks out from the pivot."""
    out = own[:, :2] - pivot[:2]
    reach = np.linalg.norm(out, axis=1)
    tip = out[reach >= 0.95 * reach.max()].mean(axis=0)
    angle = np.arctan2(tip[1], tip[0])
    quarter = np.round(angle / (np.pi / 2)) * (np.pi / 2)
    if abs(angle - quarter) < STRAIGHT:
        angle = quarter
    # Rounded, so that an axis of the vehicle comes out as exactly that.
    return np.round([np.sin(angle), -np.cos(angle), 0.0], 15) + 0.0
