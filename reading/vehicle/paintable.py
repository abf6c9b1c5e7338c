"""The paintable materials, parts, and texels of a vehicle: not tires, tracks, glass, lamps, or bare metal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hulldown.assets.naming import NOT_PAINT, PAINT, first_match

CLEAR = "it is transparent"  # reason why glass is left unpainted
DARK = 0.045  # linear light, 60 of 255 in sRGB: rubber, and glass that is painted on
NEUTRAL = 0.35  # saturation below which dark colors are rubber's
DARK_SHARES = (0.01, 0.6)  # of a material's surface that rubber and glass may have; above it, its paint is dark
MOST_PARTS = 0.6  # of a vehicle's surface; names that more of it has don't name parts
ONE_FOR_ALL = 0.9  # of a vehicle's surface that one material has, if it's also on tires and windows


@dataclass(frozen=True, slots=True)
class MaterialRow:
    """A material of a vehicle.

    Parameters
    ----------
    name
        In the file.
    share
        Of the vehicle's surface.
    color
        Mean of its base color, linear light: of an image's texels on the vehicle without those that keep
        their color, estimated for other nodes.
    left_alone
        Reason why it isn't painted; empty if it can be.
    dark
        Share of its surface as dark as rubber and glass; `keeps_dark` tells whether those texels keep their color.
    """

    name: str
    share: float
    color: tuple[float, float, float]
    left_alone: str = ""
    dark: float = 0.0

    @property
    def keeps_dark(self) -> bool:
        """Whether its dark texels are tires and windows, not paint."""
        return DARK_SHARES[0] <= self.dark <= DARK_SHARES[1]


def is_dark(color: np.ndarray) -> np.ndarray:
    """Whether linear colors are like rubber or glass: dark, and neutral or bluish."""
    low, high = color.min(axis=-1), color.max(axis=-1)
    return (high < DARK) & ((high - low < NEUTRAL * high) | (color[..., 2] >= color[..., 0]))


def parts_left_alone(names: Sequence[str], areas: np.ndarray, materials: Sequence[int]) -> np.ndarray:
    """Whether each part of a vehicle is a wheel, a window, or the like by its name.

    Parameters
    ----------
    names, areas
        Of the parts.
    materials
        Number of materials of each; several materials decide instead of the name.
    """
    kept = np.array([n == 1 and bool(left_alone_by_name(name)) for name, n in zip(names, materials, strict=True)], bool)
    return kept & (areas[kept].sum() <= MOST_PARTS * areas.sum())


def told_apart(rows: Sequence[MaterialRow], *, parts: bool) -> list[MaterialRow]:
    """Leave materials unpainted that are as dark as rubber, or that cover a whole vehicle without separate tires.

    Parameters
    ----------
    rows
        The materials of a vehicle.
    parts
        Whether any of its parts is left unpainted.
    """
    made = []
    for row in rows:
        why = row.left_alone
        if not why and not first_match(row.name, PAINT):
            if row.dark > 0.95 and row.share < DARK_SHARES[1]:
                why = "it is as dark as rubber"
            elif row.share > ONE_FOR_ALL and not parts and not row.keeps_dark:
                why = "nothing tells its paint from its tires and windows"
        made.append(replace(row, left_alone=why))
    return made


def left_alone_by_name(name: str) -> str:
    """Reason why a material of this name isn't paint; empty if there is none."""
    word = first_match(name, NOT_PAINT)
    return f"{word!r} is in its name" if word and not first_match(name, PAINT) else ""


def matches(name: str, pattern: str) -> bool:
    """Whether a pattern matches a material's name, as `assets.naming.first_match` or as a whole."""
    return name.lower() == pattern.lower() or first_match(name, [pattern]) is not None


def painted(materials: Sequence[MaterialRow], coats: Sequence[Sequence[str]]) -> dict[str, int]:
    """The coat of each painted material by name: the first with a matching pattern.

    Parameters
    ----------
    materials
        A vehicle's materials. Unpaintable ones are painted only if a pattern is their whole name.
    coats
        The patterns of each coat.
    """
    found = {}
    for row in materials:
        for k, patterns in enumerate(coats):
            if any(row.name.lower() == p.lower() or (not row.left_alone and matches(row.name, p)) for p in patterns):
                found[row.name] = k
                break
    return found
