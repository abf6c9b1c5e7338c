"""The paintable materials and parts of a vehicle: not tires, tracks, glass, lamps, or bare metal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hulldown.geometry.color import srgb_from_linear
from hulldown.reading.pieces.naming import NOT_PAINT, PAINT, first_match

CLEAR = "it is transparent"  # reason why glass is left unpainted
SEVERAL = "its texture has other colors than one paint"
DARK = 0.045  # linear light, 60 of 255 in sRGB: rubber, and glass that is painted on
NEUTRAL = 0.35  # saturation below which dark colors are rubber's
MOST_DARK = 0.6  # of a vehicle's surface; a dark material that covers more is its paint
ONE_COLOR = 0.12  # distance of sRGB colors, each from 0 to 1: dirt and shading of one paint
MOST_OTHERS = 0.03  # of a texture's texels on a vehicle that may have other colors than its paint
MOST_PARTS = 0.6  # of a vehicle's surface; names that more of it has don't name parts
ONE_FOR_ALL = 0.9  # of a vehicle's surface that one material has, if it's also on tires and windows


@dataclass(frozen=True, slots=True)
class MaterialRow:
    """A material of a vehicle."""

    name: str
    share: float
    # mean of its base color, linear light: of an image's texels on the vehicle, estimated for other nodes
    color: tuple[float, float, float]
    left_alone: str = ""  # reason why it isn't painted; empty if it can be
    alpha: float = 1.0  # the least alpha of its shaders that isn't a texture's; 1 if it's opaque


def is_one_color(texels: Float[np.ndarray, "k 3"], weight: Float[np.ndarray, " k"]) -> bool:
    """Return whether nearly all texels have one color, in linear light: paint, not an atlas with windows and tires."""
    srgb = srgb_from_linear(texels)
    order = np.argsort(srgb, axis=0)
    middle = np.argmax(np.cumsum(weight[order], axis=0) >= weight.sum() / 2, axis=0)
    median = np.take_along_axis(srgb, np.take_along_axis(order, middle[None], axis=0), axis=0)
    others = np.linalg.norm(srgb - median, axis=1) > ONE_COLOR
    return bool(weight[others].sum() <= MOST_OTHERS * weight.sum())


def _is_dark(color: Sequence[float]) -> bool:
    """Return whether a linear color is like rubber's: dark, and neutral or bluish."""
    low, high = min(color), max(color)
    return high < DARK and (high - low < NEUTRAL * high or color[2] >= color[0])


def parts_left_alone(names: Sequence[str], areas: np.ndarray, materials: Sequence[int]) -> np.ndarray:
    """Return whether each part of a vehicle is a wheel, a window, or the like by its name."""
    kept = np.array([n == 1 and bool(left_alone_by_name(name)) for name, n in zip(names, materials, strict=True)], bool)
    return kept & (areas[kept].sum() <= MOST_PARTS * areas.sum())


def told_apart(rows: Sequence[MaterialRow], *, parts: bool) -> list[MaterialRow]:
    """Leave materials unpainted that are as dark as rubber, or that cover a whole vehicle without separate tires."""
    made = []
    for row in rows:
        why = row.left_alone
        if not why and not first_match(row.name, PAINT):
            if _is_dark(row.color) and row.share < MOST_DARK:
                why = "it is as dark as rubber"
            elif row.share > ONE_FOR_ALL and not parts:
                why = "nothing tells its paint from its tires and windows"
        made.append(replace(row, left_alone=why))
    return made


def left_alone_by_name(name: str) -> str:
    """Return the reason why a material of this name isn't paint; empty if there is none."""
    word = first_match(name, NOT_PAINT)
    return f"{word!r} is in its name" if word and not first_match(name, PAINT) else ""


def matches(name: str, pattern: str) -> bool:
    """Return whether a pattern matches a material's name, as `reading.pieces.naming.first_match` or as a whole."""
    return name.lower() == pattern.lower() or first_match(name, [pattern]) is not None


def painted(materials: Sequence[MaterialRow], coats: Sequence[Sequence[str]]) -> dict[str, int]:
    """Return the coat of each painted material by name: the first with a matching pattern."""
    found = {}
    for row in materials:
        for k, patterns in enumerate(coats):
            if any(row.name.lower() == p.lower() or (not row.left_alone and matches(row.name, p)) for p in patterns):
                found[row.name] = k
                break
    return found
