"""Doubts: things in a file that look unintended, by kind, and the warnings about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

MAX_SHOWN_KINDS = 3  # a warning lists one doubt of each


class DoubtKind(StrEnum):
    """Kinds of doubts by consequence: wrong labels, wrong pictures, wrong sizes, wrong directions; then decisions."""

    LOST = "lost"
    NO_GROUND = "no_ground"
    SEVERAL = "several"
    UNLABELED = "unlabeled"
    MOST_DROPPED = "most_dropped"
    LARGEST_DROPPED = "largest_dropped"
    UP = "up"
    STEEP_GROUND = "steep_ground"
    SHEET_ABOVE = "sheet_above"
    OTHER_KIND = "other_kind"
    LEFT_OUT = "left_out"
    STRAY = "stray"
    MISSING = "missing"
    SEVERAL_PICTURES = "several_pictures"
    MAGENTA = "magenta"
    BLACK = "black"
    TRANSPARENT = "transparent"
    AROUND_ALL = "around_all"
    NO_MATERIAL = "no_material"
    PALE = "pale"
    OPACITY = "opacity"
    NOT_READ = "not_read"
    TINTED = "tinted"
    NO_OPEN_LAND = "no_open_land"
    SCALE = "scale"
    COORDINATES = "coordinates"
    FORWARD = "forward"
    PARTS = "parts"
    GROUND = "ground"
    WATER = "water"
    PIVOT = "pivot"
    NOT_GROUND = "not_ground"
    MOVED_PICTURE = "moved_picture"
    REPAIRED = "repaired"


_DOUBT_RANKS = {kind: rank for rank, kind in enumerate(DoubtKind)}


@dataclass(frozen=True, slots=True)
class Doubt:
    """Something about a file that looks unintended."""

    kind: DoubtKind
    text: str  # a sentence for the user, with the config's key to set if there is one
    # key, taken: the config's key that would state what reading had to guess, and the guess; "" where there is none
    key: str = ""
    taken: str | float | tuple[float, float, float] = ""

    def __str__(self) -> str:
        return self.text


def file_warnings(doubts: Mapping[str, Sequence[Doubt]]) -> list[str]:
    """Return a warning for each file, those with the worst doubts first, each with `MAX_SHOWN_KINDS` kinds at most."""
    ranked = {path: sorted(found, key=_doubt_rank) for path, found in doubts.items() if found}
    warnings = []
    for path, found in sorted(ranked.items(), key=lambda item: _doubt_rank(item[1][0])):
        first = list({doubt.kind: doubt for doubt in reversed(found)}.values())[::-1]  # one of each kind
        shown = [doubt.text.replace("\n", "\\n") for doubt in first[:MAX_SHOWN_KINDS]]
        more = [f"and {len(found) - len(shown)} more, which `hulldown inspect` lists"] if len(found) > len(shown) else []
        warnings.append("\n  ".join([path, *shown, *more]))
    return warnings


def _doubt_rank(doubt: Doubt) -> int:
    return _DOUBT_RANKS[doubt.kind]
