"""Doubts: things in a file that look unintended, by kind, and the warnings about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

SHOWN = 3  # doubts that a warning lists


class DoubtKind(StrEnum):
    """Kinds of doubts, those first that make pictures or labels wrong, and last those that only report a decision."""

    NO_GROUND = "no_ground"
    MISSING = "missing"
    SEVERAL = "several"
    SEVERAL_PICTURES = "several_pictures"
    MAGENTA = "magenta"
    BLACK = "black"
    TRANSPARENT = "transparent"
    SHEET_ABOVE = "sheet_above"
    AROUND_ALL = "around_all"
    NO_MATERIAL = "no_material"
    PALE = "pale"
    STEEP_GROUND = "steep_ground"
    SCALE = "scale"
    MOST_DROPPED = "most_dropped"
    UP = "up"
    FORWARD = "forward"
    TINTED = "tinted"
    PAINT = "paint"
    NO_OPEN_LAND = "no_open_land"
    OTHER_KIND = "other_kind"
    LARGEST_DROPPED = "largest_dropped"
    GROUND = "ground"
    WATER = "water"
    PARTS = "parts"
    LEFT_OUT = "left_out"
    STRAY = "stray"
    NOT_READ = "not_read"
    OPACITY = "opacity"
    COORDINATES = "coordinates"
    MOVED_PICTURE = "moved_picture"
    PIVOT = "pivot"
    NOT_GROUND = "not_ground"
    PERHAPS_WATER = "perhaps_water"
    REPAIRED = "repaired"


_RANK = {kind: rank for rank, kind in enumerate(DoubtKind)}


@dataclass(frozen=True, slots=True)
class Doubt:
    """Something in a file that looks unintended.

    Parameters
    ----------
    kind
        What it's about.
    text
        A sentence for the user, with the config's key to set if there is one.

    Examples
    --------
    >>> str(Doubt(DoubtKind.SCALE, "the vehicle is 600 m long; set scale if that is wrong"))
    'the vehicle is 600 m long; set scale if that is wrong'
    """

    kind: DoubtKind
    text: str

    def __str__(self) -> str:
        return self.text


def warnings_of(doubts: Mapping[str, Sequence[Doubt]]) -> list[str]:
    """Return one warning for each file, those with the worst doubts first, each with its worst `SHOWN` doubts.

    Parameters
    ----------
    doubts
        Doubts by path.

    Examples
    --------
    >>> odd, worse = Doubt(DoubtKind.PARTS, "odd"), Doubt(DoubtKind.MISSING, "missing: b.png")
    >>> for warning in warnings_of({"a.obj": [odd], "b.obj": [odd, odd, worse, odd]}):
    ...     print(warning)
    b.obj
      missing: b.png
      odd
      odd
      and 1 more, which `hulldown inspect` lists
    a.obj
      odd
    """
    ranked = {path: sorted(found, key=_rank) for path, found in doubts.items() if found}
    warnings = []
    for path, found in sorted(ranked.items(), key=lambda item: _rank(item[1][0])):
        shown = [doubt.text.replace("\n", "\\n") for doubt in found[:SHOWN]]
        more = [f"and {len(found) - SHOWN} more, which `hulldown inspect` lists"] if len(found) > SHOWN else []
        warnings.append("\n  ".join([path, *shown, *more]))
    return warnings


def _rank(doubt: Doubt) -> int:
    return _RANK[doubt.kind]
