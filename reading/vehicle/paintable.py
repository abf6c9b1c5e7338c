"""Which materials of a vehicle are paint: not its tyres, tracks, glass, lamps and bare metal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hulldown.assets.naming import NOT_PAINT, PAINT, says

CLEAR = "one sees through it"  # why glass is left alone


@dataclass(frozen=True, slots=True)
class MaterialRow:
    """A material of a vehicle.

    Parameters
    ----------
    name
        In the file.
    share
        Of the vehicle's surface.
    colour
        Mean of its base colour, linear light; of image textures the mean of the image, of other nodes an estimate.
    left_alone
        Why it is not painted; empty if it can be.
    """

    name: str
    share: float
    colour: tuple[float, float, float]
    left_alone: str = ""


def left_alone_by_name(name: str) -> str:
    """Why a material of this name is no paint; empty if nothing says so."""
    word = says(name, NOT_PAINT)
    return f"{word!r} is in its name" if word and not says(name, PAINT) else ""


def matches(name: str, pattern: str) -> bool:
    """Whether a pattern matches a material's name, as `assets.naming.says` or as a whole."""
    return _is_whole(name, pattern) or says(name, [pattern]) is not None


def _is_whole(name: str, pattern: str) -> bool:
    return name.lower() == pattern.lower()


def painted(materials: Sequence[MaterialRow], coats: Sequence[Sequence[str]]) -> dict[str, int]:
    """Which coat each painted material gets, by name: the first with a pattern that matches.

    Parameters
    ----------
    materials
        Those of a vehicle. One that is to be left alone is painted only if a pattern is its whole name.
    coats
        The patterns of each coat.
    """
    found = {}
    for row in materials:
        for k, patterns in enumerate(coats):
            if any(_is_whole(row.name, p) or (not row.left_alone and matches(row.name, p)) for p in patterns):
                found[row.name] = k
                break
    return found
