"""The part of a vehicle that an object belongs to, by its name, its parents', and its collections'."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from hulldown.assets.naming import (
    GUN,
    GUN_HINTS,
    LAUNCHER,
    LAUNCHER_HINTS,
    NOT_GUN,
    NOT_GUN_HINTS,
    NOT_LAUNCHER,
    TURRET,
    TURRET_HINTS,
    first_match,
    hints,
    words,
)
from hulldown.reading.roles import Link

HELPER_WORDS = ("pivot", "axis", "axle", "joint", "hinge")
HULL, TURRET_PART, GUN_PART = "hull", "turret", "gun"
Key = tuple[str, bytes]
# For each part the words that name it, the next ones only where no name matches: how they are matched, and words that
# speak against it.
TIERS = {
    TURRET_PART: (
        (first_match, TURRET, ()),
        (hints, TURRET_HINTS, ((first_match, NOT_LAUNCHER),)),
        (first_match, LAUNCHER, ((first_match, NOT_LAUNCHER),)),
        (hints, LAUNCHER_HINTS, ((hints, NOT_GUN_HINTS),)),
    ),
    GUN_PART: (
        (first_match, GUN, ((first_match, NOT_GUN),)),
        (hints, GUN_HINTS, ((first_match, NOT_GUN), (hints, NOT_GUN_HINTS))),
    ),
}


def key_of(link: Link) -> Key:
    """A key that identifies one drawn object."""
    return link.name, link.pose.tobytes()


def pivot_named(name: str) -> str | None:
    """The part whose pivot an object is by name, written as one word or several; None if it isn't one."""
    joined = "".join(words(name)).rstrip("0123456789")
    for word in HELPER_WORDS:
        for rest in (joined.removeprefix(word), joined.removesuffix(word)):
            if rest != joined:
                for part, stems in ((TURRET_PART, TURRET), (GUN_PART, GUN)):
                    if rest in stems or rest in [f"{stem}s" for stem in stems]:
                        return part
    return None


def _after_turret(name: str) -> bool:
    """Whether a word begins with "turret", as in "turretgunbase"."""
    return any(word.startswith(TURRET) for word in words(name))


class Namer:
    """Finds the part that a chain of objects belongs to, by the nearest name of a part.

    Parameters
    ----------
    chains
        Of all pieces of the vehicle.
    turret, gun
        The user's pattern instead of the built-in words; "" for none.
    no_gun
        Names of guns that aren't guns by their shape.

    Attributes
    ----------
    marked
        Objects that are a part regardless of their names: the part, and the reason.
    """

    def __init__(
        self,
        chains: Sequence[tuple[Link, ...]],
        turret: str | None,
        gun: str | None,
        *,
        no_gun: Collection[str] = (),
    ) -> None:
        all_names = [{n for link in c for n in (link.name, *link.collections)} for c in chains]
        # A name that covers the whole vehicle is the vehicle's, not a part's.
        self.whole = set.intersection(*all_names) if all_names else set()
        self.no_gun, self.marked = frozenset(no_gun), dict[Key, tuple[str, str]]()
        some = set().union(*all_names) - self.whole
        self.given = {TURRET_PART: turret, GUN_PART: gun}
        self.tier = {TURRET_PART: 0, GUN_PART: 0}
        self.turns = False
        for part, tiers in TIERS.items():
            while self.tier[part] < len(tiers) and not any(self._says(part, n) for n in some):
                self.tier[part] += 1
        self.turns = True
        # "turret_gun" is a gun beside a turret, and a turret where there is none other.
        alone = any(self._says(TURRET_PART, n) and not self._says(GUN_PART, n) for n in some)
        self.both = GUN_PART if alone else TURRET_PART

    def _says(self, part: str, name: str) -> bool:
        pattern, tier = self.given[part], self.tier[part]
        if pattern is not None:
            return bool(pattern and first_match(name, (pattern,)))
        if tier == len(TIERS[part]) or (part == GUN_PART and name in self.no_gun):
            return False
        # A helper isn't the part if another object has the name, but turns with it.
        if (helped := pivot_named(name)) and (self.turns or tier == 0):
            return helped == part and self.turns
        if part == TURRET_PART and tier == 0 and _after_turret(name):
            return True
        match, wanted, unless = TIERS[part][tier]
        return bool(match(name, wanted)) and not any(other(name, unwanted) for other, unwanted in unless)

    def part_named(self, name: str) -> str | None:
        """The part named by an object or collection, if any."""
        if name in self.whole:
            return None
        is_turret, is_gun = self._says(TURRET_PART, name), self._says(GUN_PART, name)
        return self.both if is_turret and is_gun else TURRET_PART if is_turret else GUN_PART if is_gun else None

    def part_of(self, chain: Sequence[Link]) -> str | None:
        """The part that the first object of `chain` belongs to; None: the hull."""
        return self.decided(chain)[0]

    def decided(self, chain: Sequence[Link]) -> tuple[str | None, str, str]:
        """The part, the kind of name that decided, and the name."""
        for i, link in enumerate(chain):
            if mark := self.marked.get(key_of(link)):
                return (*mark, link.name)
            for name in (link.name, *link.collections):
                if part := self.part_named(name):
                    what = "collection" if name != link.name else "parent" if i else "name"
                    return part, f"by its {what} {name!r}", name
        return None, "", ""
