"""Colors of vehicles: the config's paint, and the coats drawn from it.

Every vehicle of a position has its own coats, which all shots share. They depend only on seed, position, and the
vehicle's number in the row.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from colorsys import hsv_to_rgb, rgb_to_hsv
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float, Int
from msgspec import Meta, Struct
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, model_validator

from hulldown.geometry.color import linear_color
from hulldown.planning.config.section import Pair, Section, ranged
from hulldown.planning.search.random_streams import Purpose, RandomStreams, between
from hulldown.reading.pieces.paintable import MaterialRow, matches, painted

OWN = "own"
COMPANIONS, DISTRACTORS = 1, 65  # number in a row of the first of each; the target's is 0
_NUMBERS = 4  # drawn for each coat: color, hue, saturation, value


def _color(value: Any) -> str:
    if isinstance(value, str) and (value == OWN or re.fullmatch("#[0-9a-fA-F]{6}", value)):
        return value.lower()
    raise ValueError("expected a color such as '#4b5320', or 'own' for the file's")


def _several(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


class PaintEntry(Section):
    """Patterns of a vehicle's materials, and their colors."""

    materials: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = ("*",)
    """patterns of materials; the first table that matches applies"""
    colors: Annotated[tuple[Annotated[str, BeforeValidator(_color)], ...], Field(strict=False)] = ()
    """sRGB colors such as "#4b5320", of which one is drawn, or "own", the file's"""
    hue_deg: Annotated[Pair, ranged(-180.0, 180.0)] = (0.0, 0.0)
    """then turns hues, degrees"""
    saturation: Annotated[Pair, ranged(0.0, 10.0)] = (1.0, 1.0)
    """factor on saturation"""
    value: Annotated[Pair, ranged(0.0, 10.0)] = (1.0, 1.0)
    """factor on value (of linear light)"""

    @model_validator(mode="after")
    def _changes_something(self) -> PaintEntry:
        if not self.colors and (self.hue_deg, self.saturation, self.value) == ((0, 0), (1, 1), (1, 1)):
            raise ValueError("expected colors, hue_deg, saturation or value: nothing would be changed")
        return self


Paint = Annotated[tuple[PaintEntry, ...], BeforeValidator(_several), Field(strict=False)]


class Coat(Struct, frozen=True, gc=False):
    """The paint of some materials of a vehicle in an image.

    Parameters
    ----------
    materials
        Patterns of names; the first coat that matches a material applies to it.
    color
        sRGB; None for the file's own.
    hue_deg, saturation, value
        Rotation of the hue, and factors.
    """

    materials: list[Annotated[str, Meta(max_length=4096)]]
    color: Annotated[str, Meta(pattern="^#[0-9a-f]{6}$")] | None = None
    hue_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    saturation: Annotated[float, Meta(ge=0, le=10)] = 1.0
    value: Annotated[float, Meta(ge=0, le=10)] = 1.0


def draw_coats(
    paint: Sequence[PaintEntry], draws: RandomStreams, *, position: Int[np.ndarray, " n"], place: ArrayLike
) -> list[list[Coat]]:
    """Draw the coats of a vehicle at n positions.

    `place` is 0 for the target, `COMPANIONS` + k for companion k of the row, and `DISTRACTORS` + k for distractor k.
    """
    n, kinds = len(position), len(paint)
    if not kinds:
        return [[] for _ in range(n)]
    u = draws.uniform(Purpose.PAINT, position, place, count=_NUMBERS * kinds).reshape(n, kinds, _NUMBERS)
    columns = [_coats(entry, u[:, k]) for k, entry in enumerate(paint)]
    return [list(coats) for coats in zip(*columns, strict=True)]


def _coats(entry: PaintEntry, u: Float[np.ndarray, "n 4"]) -> list[Coat]:
    choice = np.minimum((u[:, 0] * len(entry.colors)).astype(np.int64), len(entry.colors) - 1).tolist()
    spreads = (entry.hue_deg, entry.saturation, entry.value)
    # Adding zero turns -0.0 into 0.0.
    hue, saturation, value = (
        (np.round(between(*spread, u[:, 1 + i]), 9) + 0.0).tolist() for i, spread in enumerate(spreads)
    )
    colors = [None if not entry.colors or entry.colors[c] == OWN else entry.colors[c] for c in choice]
    return [
        Coat(list(entry.materials), color, *shift)
        for color, shift in zip(colors, zip(hue, saturation, value, strict=True), strict=True)
    ]


def previewed(own: Float[np.ndarray, "3"], coats: Sequence[Coat]) -> Float[np.ndarray, "3"]:
    """Return the linear color of a vehicle in a preview: its first coat applied to its own color."""
    if not coats:
        return own
    coat = coats[0]
    hue, saturation, value = rgb_to_hsv(*(own.tolist() if coat.color is None else linear_color(coat.color)))
    turned = (hue + coat.hue_deg / 360.0) % 1.0, min(saturation * coat.saturation, 1.0), min(value * coat.value, 1.0)
    return np.array(hsv_to_rgb(*turned))


def paint_doubts(paint: Sequence[PaintEntry], materials: Sequence[MaterialRow]) -> list[str]:
    """Return a sentence for each part of a vehicle's `paint` without effect."""
    names = ", ".join(repr(row.name) for row in materials if not row.left_alone) or "none"
    doubts = []
    coat_of = painted(materials, [entry.materials for entry in paint])
    for k, entry in enumerate(paint):
        for pattern in entry.materials:
            alike = [row for row in materials if matches(row.name, pattern)]
            if not alike:
                doubts.append(f"paint: {pattern!r} matches no material; those that can be painted: {names}")
            elif not any(row.name in coat_of for row in alike):
                why = f"{alike[0].name!r} is left alone, {alike[0].left_alone}"
                doubts.append(f"paint: {pattern!r} paints nothing: {why}; give its whole name if it is to be painted")
        if entry.materials and k not in coat_of.values() and not any("paint:" in doubt for doubt in doubts):
            doubts.append(f"paint: an earlier entry has all materials of {list(entry.materials)}")
    return doubts


def paint_notes(paint: Sequence[PaintEntry], materials: Sequence[MaterialRow]) -> list[str]:
    """Return a line for each entry of a vehicle's `paint`, with its effect."""
    coat_of = painted(materials, [entry.materials for entry in paint])
    lines = []
    for k, entry in enumerate(paint):
        on = ", ".join(name for name, which in coat_of.items() if which == k) or "nothing"
        spreads = [
            f"{key} {low:g} to {high:g}"
            for key, (low, high), none in (
                ("hue_deg", entry.hue_deg, 0.0),
                ("saturation", entry.saturation, 1.0),
                ("value", entry.value, 1.0),
            )
            if (low, high) != (none, none)
        ]
        lines.append(f"painted: {on}; {', '.join([*entry.colors, *spreads])}")
    return lines
