"""The turret and the gun among a vehicle's pieces, by names, else by shape and position, and their pivots."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from hulldown.geometry.transforms import transform_points
from hulldown.reading.pieces.asset_report import PartRow, xyz_tuple
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.naming import (
    BODY_WORDS,
    FRONT_WORDS,
    REAR_WORDS,
    TURRET_WORDS,
    TURRETLESS_WORDS,
    VEHICLE_PART_WORDS,
    WEAPON_WORDS,
    first_matching_pattern,
)
from hulldown.reading.pieces.options import DEFAULT_OPTIONS, Options
from hulldown.reading.pieces.roles import Link, Piece
from hulldown.reading.pieces.wording import MAX_LISTED_NAMES, quote_names
from hulldown.reading.vehicle.nose import gun_barrel_index, nose_vote_by_rising_tubes, snap_to_right_angle
from hulldown.reading.vehicle.part_names import (
    GUN_PART,
    HULL,
    TURRET_PART,
    MarkedParts,
    Naming,
    ObjectKey,
    link_key,
    part_by_name,
)
from hulldown.reading.vehicle.pivots import MIN_RING_WIDTH_SHARE, PIVOT_KEYS, find_pivot
from hulldown.reading.vehicle.solids import PlacedPieces, Solids, touching_cluster_labels

ANGLE_LIMITS = {TURRET_PART: (-np.pi, np.pi), GUN_PART: (float(np.radians(-5.0)), float(np.radians(20.0)))}
MAX_GUN_ANGLE_RADIANS = np.radians(15.0)  # a gun this close to an axis of the vehicle points along it

MAX_PIECE_GAP_SHARE = 0.05  # of the longer of two pieces: closer ones are one thing
MAX_STUBBY_RATIO = 2.5  # length over width; shorter pieces have no direction
MAX_DRUM_SHARE = 0.2  # of the vehicle's length: a drum isn't a gun
MAX_GUN_WIDTH_SHARE = 0.45  # of the vehicle's width, for a gun with all that hangs on it
MIN_TURRET_HEIGHT_SHARE = 0.3  # of the vehicle's height: no turret reaches below
KNOWN_WORDS = (*VEHICLE_PART_WORDS, *FRONT_WORDS, *REAR_WORDS, *BODY_WORDS)
MIN_BARREL_SHARE = 0.7  # of a piece's length: the piece is the barrel, and not a body with a barrel
MAX_PREFIXED_TURRETS = 2  # with more objects named turret, the author has named all that belongs to it


@dataclass(frozen=True, eq=False, slots=True)
class Parts:
    """The rigid parts of a vehicle."""

    moving: tuple[PartRow, ...]  # the turret, if there is one, then the gun; pivots and axes in the frame of the pieces
    piece_part: tuple[int, ...]  # for each piece the number of its part: 0 for the hull, 1 for the first that moves
    # for each piece the name by which it belongs, or seems to belong, to its part; empty for other parts of the hull
    piece_why: tuple[str, ...]
    doubts: tuple[Doubt, ...]  # sentences for the user, with the key to set


def find_parts(whole: PlacedPieces, options: Options = DEFAULT_OPTIONS) -> Parts:
    """Find the hull, turret, and gun among the pieces of a vehicle, by the config's turret, gun, and pivots."""
    naming, doubts = _naming_and_doubts(whole, options)
    decided = [naming.part_reason_and_name(piece.chain) for piece in whole.pieces]
    part_of = [part for part, _, _ in decided]
    by_part = {name: whole.where([part == name for part in part_of]) for name in (None, TURRET_PART, GUN_PART)}
    moving: list[PartRow] = []
    piece_part = np.zeros(len(whole.pieces), int)
    bounds = whole.bounds
    behind = (bounds[:, 0].min(axis=0) + bounds[:, 1].max(axis=0)) / 2
    for name in (TURRET_PART, GUN_PART):
        own = by_part[name]
        if len(own.pieces) in (0, len(whole.pieces)):
            continue
        pivot = find_pivot(whole, by_part, name, naming=naming, behind=behind, options=options)
        if pivot.guessed:
            key, at = PIVOT_KEYS[name], transform_points(np.linalg.inv(whole.vehicle_from_file), pivot.at[None])[0]
            text = f"the {name} turns about {pivot.why}; set {key} if that is wrong"
            doubts.append(Doubt(DoubtKind.PIVOT, text, key, xyz_tuple(np.round(at, 6))))
        behind = pivot.at
        axis = np.array([0.0, 0.0, 1.0])
        if name == GUN_PART:
            axis = _raising_axis(own.all_vertices, pivot.at)
        parent = moving[0].name if moving else HULL
        moving.append(PartRow(name, parent, xyz_tuple(pivot.at), xyz_tuple(axis), ANGLE_LIMITS[name], pivot.why))
        piece_part[np.array(part_of) == name] = len(moving)
    doubts += _missing_part_doubts([row.name for row in moving], options, naming.no_gun)
    if not moving and not doubts and options.turret is None and options.gun is None:
        doubts += unnamed_part_doubts(whole)
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


def _naming_and_doubts(whole: PlacedPieces, options: Options) -> tuple[Naming, list[Doubt]]:
    naming, doubts = naming_without_drums(whole, options), list[Doubt]()
    for find in (turret_marks_and_doubts, gun_marks_and_doubts):
        marked, more = find(whole, [naming.chain_part(piece.chain) for piece in whole.pieces], options)
        naming = replace(naming, marked={**naming.marked, **marked})
        doubts += more
    return naming, doubts


def _missing_part_doubts(names: Sequence[str], options: Options, no_guns: Collection[str]) -> list[Doubt]:
    if TURRET_PART in names and GUN_PART not in names and options.gun is None:
        drums = f" ({quote_names(sorted(no_guns), most=3)} are shaped like drums)" if no_guns else ""
        return [_parts_doubt(f'it has a turret but no gun was found{drums}; set gun to its name, or to "" if it has none')]
    if GUN_PART in names and TURRET_PART not in names and options.turret is None:
        return [_parts_doubt('it has a gun but no turret was found; set turret to its name, or to "" if it has none')]
    return []


def _raising_axis(own: Float[np.ndarray, "n 3"], pivot: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the horizontal axis about which positive angles raise the part that extends from the pivot."""
    out = own[:, :2] - pivot[:2]
    reach = np.linalg.norm(out, axis=1)
    tip = out[reach >= 0.95 * reach.max()].mean(axis=0)
    angle = snap_to_right_angle(float(np.arctan2(tip[1], tip[0])), MAX_GUN_ANGLE_RADIANS)
    # Rounded, so that an axis of the vehicle comes out as exactly that.
    return np.round([np.sin(angle), -np.cos(angle), 0.0], 15) + 0.0


def naming_without_drums(whole: PlacedPieces, options: Options) -> Naming:
    """Return what names parts, but call no drum-shaped part a gun."""
    chains = [piece.chain for piece in whole.pieces]
    no_guns: set[str] = set()
    while True:
        naming = Naming(part_by_name(whole, options, no_gun=no_guns), frozenset(no_guns))
        is_gun = np.array([naming.chain_part(chain) == GUN_PART for chain in chains], bool)
        if options.gun is not None or not is_gun.any() or is_gun.all():
            return naming
        body = whole.where(~is_gun).all_vertices
        groups = _close_piece_clusters(whole.bounds, np.flatnonzero(is_gun))
        drums = [group for group in groups if _is_drum(np.concatenate([whole.points[i] for i in group]), body)]
        if not drums:
            return naming
        no_guns |= {naming.part_reason_and_name(chains[i])[2] for group in drums for i in group}


def _close_piece_clusters(bounds: Float[np.ndarray, "k 2 3"], among: Int[np.ndarray, " n"]) -> list[list[int]]:
    own = bounds[among]
    longest = np.ptp(own, axis=1).max(axis=1)
    label = touching_cluster_labels(own, MAX_PIECE_GAP_SHARE * np.maximum.outer(longest, longest))
    return [among[label == k].tolist() for k in np.unique(label)]


def _is_drum(own: Float[np.ndarray, "n 3"], body: Float[np.ndarray, "m 3"]) -> bool:
    low, high = body.min(axis=0), body.max(axis=0)
    off = own - own.mean(axis=0)
    axes = np.linalg.eigh(off.T @ off)[1].T[::-1]
    size = np.ptp(off @ axes.T, axis=0)
    if not 0 < size[0] < MAX_DRUM_SHARE * (high[0] - low[0]):
        return False
    stubby = size[0] < MAX_STUBBY_RATIO * size[1:].max()
    across = abs(axes[0, 0]) < 0.5
    middle = (own.min(axis=0) + own.max(axis=0)) / 2
    return bool((stubby or across) and (middle[0] < (low[0] + high[0]) / 2 or middle[2] < low[2] + 0.5 * (high - low)[2]))


def gun_marks_and_doubts(
    whole: PlacedPieces, part_of: Sequence[str | None], options: Options
) -> tuple[MarkedParts, list[Doubt]]:
    """Find the gun, and the turret if none is named, by a barrel's shape and its parents; return doubts too."""
    if options.gun is not None or GUN_PART in part_of:
        return {}, []
    pieces, solids, bounds = whole.pieces, whole.solids, whole.bounds
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    wide = np.ptp(bounds[:, :, 0], axis=1) < 0.9 * (high - low)[0]
    body = bounds[wide] if wide.any() else bounds
    middle = (body[:, 0].min(axis=0) + body[:, 1].max(axis=0)) / 2
    barrel = gun_barrel_index(solids, np.array([1.0, 0, 0]), middle, float((high - low)[0]) / 2)
    if barrel is None:
        return {}, []
    piece = int(solids.piece[barrel])
    name = pieces[piece].name
    one = float(np.ptp(whole.points[piece], axis=0).max()) * MIN_BARREL_SHARE < float(solids.size[barrel, 0])
    if not one:
        doubt = f'{name!r} has a long barrel in it that cannot be raised; make it an object of its own, or set gun = ""'
        return {}, [_parts_doubt(doubt + ("" if TURRET_PART in part_of else ' and turret = ""'))]
    carried = _piece_indices_by_link(pieces)

    def extent(link: Link) -> Float[np.ndarray, "2 3"]:
        some = bounds[carried[link_key(link)]]
        return np.array([some[:, 0].min(axis=0), some[:, 1].max(axis=0)])

    chain = pieces[piece].chain
    narrow = [k for k in chain if np.ptp(extent(k), axis=0)[1] < MAX_GUN_WIDTH_SHARE * (high - low)[1]]
    gun = narrow[-1] if narrow else chain[0]
    marks = {link_key(gun): (GUN_PART, f"by the shape of {name!r}")}
    taken = f"{gun.name!r} is taken for the gun by its shape"
    if TURRET_PART not in part_of and options.turret is None:
        upper = [
            k
            for k in chain
            if extent(k)[0, 2] > low[2] + MIN_TURRET_HEIGHT_SHARE * (high - low)[2]
            and len(carried[link_key(k)]) > len(carried[link_key(gun)])
        ]
        if not upper:
            doubt = f'{name!r} looks like a gun; set gun, and turret, to what turns, or both to "" if nothing does'
            return {}, [_parts_doubt(doubt)]
        marks[link_key(upper[-1])] = (TURRET_PART, f"by its gun {name!r}")
        taken += f", and {upper[-1].name!r} for the turret, which it hangs from"
    return marks, [_parts_doubt(f"{taken}; set gun and turret if that is wrong")]


def _piece_indices_by_link(pieces: Sequence[Piece]) -> dict[ObjectKey, list[int]]:
    carried: dict[ObjectKey, list[int]] = {}
    for i, piece in enumerate(pieces):
        for link in piece.chain:
            carried.setdefault(link_key(link), []).append(i)
    return carried


def turret_marks_and_doubts(
    whole: PlacedPieces, part_of: Sequence[str | None], options: Options
) -> tuple[MarkedParts, list[Doubt]]:
    """Find pieces on a turret without children, for files without a hierarchy; return a doubt about them too."""
    chains = [piece.chain for piece in whole.pieces]
    members = [i for i, part in enumerate(part_of) if part == TURRET_PART and options.turret is None]
    if not members or any(len(chains[i]) > 1 and chains[i][1].kind == "MESH" for i in members):
        return {}, []
    roots = {link_key(chains[i][-1]) if len(chains[i]) > 1 else None for i in members}
    parents = [link_key(chain[1]) if len(chain) > 1 else None for chain in chains]
    named = sum(first_matching_pattern(chains[i][0].name, TURRET_WORDS) is not None for i in members)
    if len(roots) > 1 or len({parents[i] for i in members}) > 1 or named > MAX_PREFIXED_TURRETS:
        return {}, []
    bounds = whole.bounds
    low, high = bounds[members, 0].min(axis=0), bounds[members, 1].max(axis=0)
    slack = 0.15 * (high - low)
    aboard = []
    for i, part in enumerate(part_of):
        if part is not None or parents[i] != parents[members[0]]:
            continue
        own_low, own_high = bounds[i]
        middle = (own_low + own_high) / 2
        over = bool(((middle > low - slack) & (middle < high + slack))[:2].all()) and middle[2] > low[2] + slack[2]
        if over and own_low[2] > low[2] and (own_high - own_low)[1] < 1.3 * (high - low)[1]:
            aboard.append(chains[i][0])
    if not aboard:
        return {}, []
    doubt = (
        f"{quote_names((link.name for link in aboard), most=MAX_LISTED_NAMES)} are on the turret and turn with it; "
        "if that is wrong, set turret and gun to the parts that turn and rise"
    )
    return {link_key(link): (TURRET_PART, "by its place on the turret") for link in aboard}, [_parts_doubt(doubt)]


def unnamed_part_doubts(whole: PlacedPieces) -> list[Doubt]:
    """Return a doubt about possible aiming parts: by parents, by a name, or by shape if names are meaningless."""
    pieces, bounds = whole.pieces, whole.bounds
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    carried = _piece_indices_by_link(pieces)
    upper = [
        key
        for key, some in carried.items()
        if 1 < len(some) < len(pieces)
        and bounds[some, 0, 2].min() > low[2] + MIN_TURRET_HEIGHT_SHARE * (high - low)[2]
        and not first_matching_pattern(key[0], TURRETLESS_WORDS)
    ]
    if upper:
        most = max(upper, key=lambda key: len(carried[key]))
        return [
            _parts_doubt(
                f"{len(carried[most])} objects hang from {most[0]!r} above the rest; if it turns, set turret to it, "
                f'and gun to what rises; if nothing does, set turret = ""'
            )
        ]
    if armed := next((p.name for p in pieces if first_matching_pattern(p.name, WEAPON_WORDS)), None):
        doubt = f'{armed!r} is there, but nothing named turret or gun; set turret and gun, or turret = "" and gun = ""'
        return [_parts_doubt(doubt)]
    known = any(first_matching_pattern(n, KNOWN_WORDS) for p in pieces for n in (p.name, p.data))
    if len(pieces) > 1 and not known and _has_ring_or_raised_tubes(whole.solids, low, high):
        return [_parts_doubt('its names name no part; set turret and gun if it has any, or turret = ""')]
    return []


def _has_ring_or_raised_tubes(solids: Solids, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> bool:
    size = high - low
    ring = (
        (solids.round_about >= 0)
        & (np.abs(solids.round_axis[:, 2]) > 0.99)
        & (2 * solids.radius > MIN_RING_WIDTH_SHARE * size[1])
    )
    ring &= solids.center[:, 2] > low[2] + MIN_TURRET_HEIGHT_SHARE * size[2]
    return bool(ring.any() or nose_vote_by_rising_tubes(solids, np.array([1.0, 0, 0]), size[0]))


def _parts_doubt(text: str) -> Doubt:
    return Doubt(DoubtKind.PARTS, text)
