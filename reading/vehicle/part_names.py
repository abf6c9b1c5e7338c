"""The part of a vehicle that an object belongs to, by its name, its parents', and its collections'."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from hulldown.reading.pieces.naming import (
    GUN_HINTS,
    GUN_WORDS,
    LAUNCHER_HINTS,
    LAUNCHER_WORDS,
    NOT_GUN,
    NOT_GUN_HINTS,
    NOT_LAUNCHER,
    TURRET_HINTS,
    TURRET_WORDS,
    first_matching_pattern,
    first_matching_stem,
    name_words,
)
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import Link
from hulldown.reading.vehicle.solids import PlacedPieces

HELPER_WORDS = ("pivot", "axis", "axle", "joint", "hinge")
HULL, TURRET_PART, GUN_PART = "hull", "turret", "gun"
ObjectKey = tuple[str, bytes]
MarkedParts = Mapping[ObjectKey, tuple[str, str]]  # the part that an object is regardless of its name, and the reason


def _has_turret_word(name: str, stems: tuple[str, ...]) -> bool:
    return bool(first_matching_pattern(name, stems)) or any(word.startswith(stems) for word in name_words(name))


# For each part the words that name it, the next ones only where no name matches: how they are matched, and words that
# speak against it.
NAME_TIERS = {
    TURRET_PART: (
        (_has_turret_word, TURRET_WORDS, ()),
        (first_matching_stem, TURRET_HINTS, ((first_matching_pattern, NOT_LAUNCHER),)),
        (first_matching_pattern, LAUNCHER_WORDS, ((first_matching_pattern, NOT_LAUNCHER),)),
        (first_matching_stem, LAUNCHER_HINTS, ((first_matching_stem, NOT_GUN_HINTS),)),
    ),
    GUN_PART: (
        (first_matching_pattern, GUN_WORDS, ((first_matching_pattern, NOT_GUN),)),
        (first_matching_stem, GUN_HINTS, ((first_matching_pattern, NOT_GUN), (first_matching_stem, NOT_GUN_HINTS))),
    ),
}


def link_key(link: Link) -> ObjectKey:
    """Return a key that identifies one drawn object."""
    return link.name, link.pose.tobytes()


def part_by_pivot_name(name: str) -> str | None:
    """Return the part whose pivot an object is by its name, in one word or several; None if it isn't a pivot."""
    joined = "".join(name_words(name)).rstrip("0123456789")
    for word in HELPER_WORDS:
        for rest in (joined.removeprefix(word), joined.removesuffix(word)):
            if rest != joined:
                for part, stems in ((TURRET_PART, TURRET_WORDS), (GUN_PART, GUN_WORDS)):
                    if rest in stems or rest in [f"{stem}s" for stem in stems]:
                        return part
    return None


@dataclass(frozen=True, eq=False, slots=True)
class Naming:
    """The names and marks that decide which part an object belongs to."""

    parts: Mapping[str, str]  # name of an object or a collection -> the part that it names
    no_gun: frozenset[str]  # names of guns that aren't guns by their shape
    marked: MarkedParts = field(default_factory=dict)  # objects that are a part regardless of their names

    def chain_part(self, chain: Sequence[Link]) -> str | None:
        """Return the part that the first object of `chain` belongs to, by the nearest part's name; None: the hull."""
        return self.part_reason_and_name(chain)[0]

    def part_reason_and_name(self, chain: Sequence[Link]) -> tuple[str | None, str, str]:
        """Return the part, the reason in words, and the name that decided; None and "" for the hull."""
        for i, link in enumerate(chain):
            if mark := self.marked.get(link_key(link)):
                return (*mark, link.name)
            for name in (link.name, *link.collections):
                if part := self.parts.get(name):
                    what = "collection" if name != link.name else "parent" if i else "name"
                    return part, f"by its {what} {name!r}", name
        return None, "", ""


def part_by_name(whole: PlacedPieces, options: Options, *, no_gun: Collection[str]) -> dict[str, str]:
    """Return the part that each name of an object or collection names, if any, by the user's patterns if given."""
    of_pieces = [_chain_names(piece.chain) for piece in whole.pieces]
    # A name that covers the whole vehicle is the vehicle's, not a part's.
    shared = set.intersection(*of_pieces) if of_pieces else set()
    drawn = set().union(*of_pieces)
    known = drawn.union(*map(_chain_names, whole.markers)) - shared
    turret = _part_names(TURRET_PART, options.turret, known, drawn)
    gun = _part_names(GUN_PART, options.gun, known.difference(no_gun), drawn)
    # "turret_gun" is a gun beside a turret, and a turret where there is none other.
    both = GUN_PART if (turret - gun) & drawn else TURRET_PART
    return dict.fromkeys(turret, TURRET_PART) | dict.fromkeys(gun, GUN_PART) | dict.fromkeys(turret & gun, both)


def _chain_names(chain: Sequence[Link]) -> set[str]:
    return {name for link in chain for name in (link.name, *link.collections)}


def _part_names(part: str, pattern: str | None, known: set[str], drawn: set[str]) -> set[str]:
    if pattern is not None:
        return {name for name in known if pattern and first_matching_pattern(name, (pattern,))}
    helped = {name: part_by_pivot_name(name) for name in known}
    helpers = {name for name in known if helped[name]}
    for tier, (match, wanted, unless) in enumerate(NAME_TIERS[part]):
        found = {n for n in known if match(n, wanted) and not any(other(n, unwanted) for other, unwanted in unless)}
        if (found if tier else found - helpers) & drawn:
            # A helper isn't the part if another object has the name, but turns with it.
            return (found - helpers) | {name for name in helpers if helped[name] == part}
    return set()
