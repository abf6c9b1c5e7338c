"""Which pieces of a vehicle are turret and gun, and about what they turn. Knows names and places, not Blender."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from assets.naming import GUN, LAUNCHER, NOT_GUN, NOT_LAUNCHER, PIVOT, TURRET, says, words
from geometry.transforms import apply
from reading.roles import Link, Piece

HULL, TURRET_PART, GUN_PART = "hull", "turret", "gun"
LIMITS = {TURRET_PART: (-np.pi, np.pi), GUN_PART: (float(np.radians(-5.0)), float(np.radians(20.0)))}
BELIEVED = 0.25  # a mesh object's origin may lie outside the part by this share of the part's longest side
REAR = 0.4  # a gun turns about something in this rear share of it, not about the middle that a cylinder starts with
STRAIGHT = np.radians(15.0)  # a gun that points this close to an axis of the vehicle points along it


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
        For each piece the name by which it belongs to its part; empty for the hull.
    """

    names: tuple[str, ...]
    piece_part: tuple[int, ...]
    parent: tuple[int, ...]
    pivot: Float[np.ndarray, "p 3"]
    axis: Float[np.ndarray, "p 3"]
    limits: Float[np.ndarray, "p 2"]
    why: tuple[str, ...]
    piece_why: tuple[str, ...]


def find_parts(
    pieces: Sequence[Piece],
    points: Sequence[Float[np.ndarray, "_ 3"]],
    markers: Sequence[tuple[Link, ...]],
    *,
    vehicle_from_file: Float[np.ndarray, "4 4"],
    turret: str | None = None,
    gun: str | None = None,
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
    turret, gun
        The user's pattern in place of the built-in words; "" for none.
    """
    chains = [p.chain for p in pieces]
    namer = _Namer(chains, turret, gun)
    part_of = [namer.part_of(chain) for chain in chains]
    names, parents, why = [HULL], [-1], [""]
    pivots, axes, limits = [np.zeros(3)], [np.array([0.0, 0.0, 1.0])], [(0.0, 0.0)]
    piece_part = np.zeros(len(pieces), int)
    bounds = np.array([[p.min(axis=0), p.max(axis=0)] for p in points])
    middle = (bounds[:, 0].min(axis=0) + bounds[:, 1].max(axis=0)) / 2
    for name in (TURRET_PART, GUN_PART):
        mine = np.array([p == name for p in part_of], bool)
        if not mine.any() or mine.all():
            continue
        own = np.concatenate([points[i] for i in np.flatnonzero(mine)])
        nodes = _nodes(pieces, markers, mine, namer, name)
        pivot, source = _pivot(nodes, own, name, pivots[-1] if len(pivots) > 1 else middle, vehicle_from_file)
        parents.append(names.index(TURRET_PART) if TURRET_PART in names else 0)
        piece_part[mine] = len(names)
        names.append(name)
        pivots.append(pivot)
        axes.append(_raising_axis(own, pivot) if name == GUN_PART else np.array([0.0, 0.0, 1.0]))
        limits.append(LIMITS[name])
        why.append(source)
    return Parts(
        tuple(names),
        tuple(int(i) for i in piece_part),
        tuple(parents),
        np.array(pivots),
        np.array(axes),
        np.array(limits),
        tuple(why),
        tuple(namer.reason(chain) if part else "" for chain, part in zip(chains, piece_part, strict=True)),
    )


class _Namer:
    """Says which part a chain of objects belongs to: the nearest name that says anything decides."""

    def __init__(self, chains: Sequence[tuple[Link, ...]], turret: str | None, gun: str | None) -> None:
        all_names = [{n for link in c for n in (link.name, *link.collections)} for c in chains]
        # A name that covers the whole vehicle names the vehicle, no part of it.
        self.whole = set.intersection(*all_names) if all_names else set()
        some = set().union(*all_names) - self.whole
        self.turret: tuple[str, ...] = TURRET
        self.not_turret: tuple[str, ...] = ()
        if turret is not None:
            self.turret = (turret,) if turret else ()
        elif not any(says(n, TURRET) for n in some):
            self.turret, self.not_turret = LAUNCHER, NOT_LAUNCHER
        self.gun = GUN if gun is None else (gun,) if gun else ()
        self.not_gun = NOT_GUN if gun is None else ()
        # "turret_gun" is a gun beside a turret, and a turret where there is none other.
        self.both = GUN_PART if any(self._says_turret(n) and not self._says_gun(n) for n in some) else TURRET_PART

    def _says_turret(self, name: str) -> bool:
        return bool(says(name, self.turret)) and not says(name, self.not_turret)

    def _says_gun(self, name: str) -> bool:
        return bool(says(name, self.gun)) and not says(name, self.not_gun)

    def part_named(self, name: str) -> str | None:
        """The part that an object or collection of this name is, if any."""
        if name in self.whole:
            return None
        is_turret, is_gun = self._says_turret(name), self._says_gun(name)
        return self.both if is_turret and is_gun else TURRET_PART if is_turret else GUN_PART if is_gun else None

    def part_of(self, chain: Sequence[Link]) -> str | None:
        """The part that the first object of `chain` belongs to, None for the hull."""
        return self._decided(chain)[0]

    def reason(self, chain: Sequence[Link]) -> str:
        """By what `part_of` decided."""
        return self._decided(chain)[1]

    def _decided(self, chain: Sequence[Link]) -> tuple[str | None, str]:
        for i, link in enumerate(chain):
            for name in (link.name, *link.collections):
                if part := self.part_named(name):
                    what = "collection" if name != link.name else "parent" if i else "name"
                    return part, f"by its {what} {name!r}"
        return None, ""


@dataclass(frozen=True, eq=False, slots=True)
class _Node:
    """An object of a part, as a place to turn about."""

    link: Link
    topmost: bool  # what it hangs from is another part
    named: bool  # its own name says the part, not only its collection
    faces: int  # triangles of the part that it carries, itself included


def _nodes(
    pieces: Sequence[Piece],
    markers: Sequence[tuple[Link, ...]],
    mine: Bool[np.ndarray, " _"],
    namer: _Namer,
    part: str,
) -> list[_Node]:
    links: dict[tuple[str, bytes], tuple[Link, bool]] = {}
    faces: dict[tuple[str, bytes], int] = {}
    carried = [(p.chain, p.faces) for p, m in zip(pieces, mine, strict=True) if m]
    for chain, count in [*carried, *((m, 0) for m in markers)]:
        for i, link in enumerate(chain):
            if namer.part_of(chain[i:]) != part:
                break
            key = (link.name, link.pose.tobytes())
            links.setdefault(key, (link, namer.part_of(chain[i + 1 :]) != part))
            faces[key] = faces.get(key, 0) + count
    return [
        _Node(link, topmost, namer.part_named(link.name) == part, faces[key]) for key, (link, topmost) in links.items()
    ]


def _pivot(
    nodes: list[_Node],
    own: Float[np.ndarray, "n 3"],
    part: str,
    behind: Float[np.ndarray, "3"],
    vehicle_from_file: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "3"], str]:
    def origin(node: _Node) -> Float[np.ndarray, "3"]:
        return apply(vehicle_from_file, node.link.pose[:3, 3][None])[0]

    def rank(node: _Node) -> tuple[bool, bool, int]:
        bare = tuple(w for w in words(node.link.name) if not w.isdigit())
        return (not node.topmost, bare != (part,), -node.faces)

    def first(some: list[_Node]) -> _Node | None:
        return min(some, key=rank, default=None)

    if node := first([n for n in nodes if says(n.link.name, PIVOT)]):
        return origin(node), f"origin of {node.link.name!r}, named pivot"
    if node := first([n for n in nodes if n.named and n.link.kind == "EMPTY"]):
        return origin(node), f"origin of the empty {node.link.name!r}"
    total = sum(n.faces for n in nodes if n.topmost)
    node = (
        first([n for n in nodes if n.named])
        or first([n for n in nodes if n.link.kind == "EMPTY" and 2 * n.faces > total])
        or min(nodes, key=lambda n: (n.link.kind == "EMPTY", -n.faces))
    )
    at = origin(node)
    if node.link.kind == "EMPTY":
        return at, f"origin of the empty {node.link.name!r}"
    low, high = own.min(axis=0), own.max(axis=0)
    slack = BELIEVED * float(max(high - low))
    outside = bool(((at < low - slack) | (at > high + slack)).any())
    if part == TURRET_PART:
        middle = (low + high) / 2
        guess, where, wrong = np.array([middle[0], middle[1], low[2]]), "the middle of its bounding box", outside
    else:
        rear, front = _ends(own, behind)
        guess, where = rear, "the middle of its rear end"
        along = float((at - rear) @ (front - rear)) / float((front - rear) @ (front - rear))
        wrong = outside or along > REAR
    if not wrong:
        return at, f"origin of {node.link.name!r}"
    return guess, f"{where}, since the origin of {node.link.name!r} is not where a {part} turns"


def _ends(
    own: Float[np.ndarray, "n 3"], behind: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Middle of the rear and of the front end of a gun; the front is away from `behind`."""
    low, high = own.min(axis=0), own.max(axis=0)
    axis = int(np.argmax((high - low)[:2]))
    rear, front = (low + high) / 2, (low + high) / 2
    forward = rear[axis] >= behind[axis] - 0.1 * (high - low)[axis]
    rear[axis], front[axis] = (low[axis], high[axis]) if forward else (high[axis], low[axis])
    return rear, front


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
