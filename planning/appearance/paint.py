"""Colors of vehicles: what a config says of their materials, and what is drawn of it for a position.

Every vehicle of a position has coats of its own, which all shots share. A coat is a function of the seed, the position
and the vehicle's place in the row alone.
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
from hulldown.planning.search.draws import Purpose, RandomStreams, between
from hulldown.reading.vehicle.paintable import MaterialRow, matches, painted

OWN = "own"
COMPANIONS, DISTRACTORS = 1, 65  # places in a row from which on they are; the target's is 0
_NUMBERS = 4  # drawn for each coat: color, hue, saturation, value


def _color(value: Any) -> str:
    if isinstance(value, str) and (value == OWN or re.fullmatch("#[0-9a-fA-F]{6}", value)):
        return value.lower()
    raise ValueError("expected a color such as '#4b5320', or 'own' for the file's")


def _several(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


class PaintEntry(Section):
    """Materials of a vehicle, and the colors that they may have."""

    materials: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = Field(
        default=("*",), description="patterns of materials; the first table that matches applies"
    )
    colors: Annotated[tuple[Annotated[str, BeforeValidator(_color)], ...], Field(strict=False)] = Field(
        default=(),
        description='sRGB colors such as "#4b5320", of which one is drawn, or "own", the file\'s',
    )
    hue_deg: Annotated[Pair, ranged(-180.0, 180.0)] = Field(default=(0.0, 0.0), description="then turns hues, degrees")
    saturation: Annotated[Pair, ranged(0.0, 10.0)] = Field(default=(1.0, 1.0), description="factor on saturation")
    value: Annotated[Pair, ranged(0.0, 10.0)] = Field(
        default=(1.0, 1.0), description="factor on value (of linear light)"
    )

    @model_validator(mode="after")
    def _changes_something(self) -> PaintEntry:
        if not self.colors and (self.hue_deg, self.saturation, self.value) == ((0, 0), (1, 1), (1, 1)):
            raise ValueError("expected colors, hue_deg, saturation or value: nothing would be changed")
        return self


Paint = Annotated[tuple[PaintEntry, ...], BeforeValidator(_several), Field(strict=False)]


class Coat(Struct, frozen=True, gc=False):
    """What some materials of a vehicle look like in an image.

    Parameters
    ----------
    materials
        Patterns of their names; of several coats the first that matches is a material's.
    color
        sRGB; None for the file's own.
    hue_deg
        What its hue is turned by.
    saturation, value
        Factors.
    """

    materials: list[Annotated[str, Meta(max_length=4096)]]
    color: Annotated[str, Meta(pattern="^#[0-9a-f]{6}$")] | None = None
    hue_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    saturation: Annotated[float, Meta(ge=0, le=10)] = 1.0
    value: Annotated[float, Meta(ge=0, le=10)] = 1.0


def draw_coats(
    paint: Sequence[PaintEntry], draws: RandomStreams, *, position: Int[np.ndarray, " n"], place: ArrayLike
) -> list[list[Coat]]:
    """The coats of a vehicle at n positions.

    Parameters
    ----------
    paint
        What the config says of it.
    draws
        The plan's numbers.
    position
        (n,) the positions' numbers.
    place
        (n,) or one: 0 for the target, `COMPANIONS` + k for the k-th companion of the row, `DISTRACTORS` + k for the
        k-th distractor.
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
    # Adding zero makes -0.0 the 0.0 that is meant.
    hue, saturation, value = (
        (np.round(between(*spread, u[:, 1 + i]), 9) + 0.0).tolist() for i, spread in enumerate(spreads)
    )
    colors = [None if not entry.colors or entry.colors[c] == OWN else entry.colors[c] for c in choice]
    return [
        Coat(list(entry.materials), color, *shift)
        for color, shift in zip(colors, zip(hue, saturation, value, strict=True), strict=True)
    ]


def previewed(own: Float[np.ndarray, "3"], coats: Sequence[Coat]) -> Float[np.ndarray, "3"]:
    """The color of a vehicle in a preview, linear: that of its first coat, on the one that stands for its own."""
    if not coats:
        return own
    coat = coats[0]
    hue, saturation, value = rgb_to_hsv(*(own.tolist() if coat.color is None else linear_color(coat.color)))
    turned = (hue + coat.hue_deg / 360.0) % 1.0, min(saturation * coat.saturation, 1.0), min(value * coat.value, 1.0)
    return np.array(hsv_to_rgb(*turned))


def paint_doubts(paint: Sequence[PaintEntry], materials: Sequence[MaterialRow]) -> list[str]:
    """What in a vehicle's `paint` does nothing, a sentence each."""
    names = ", ".join(repr(row.name) for row in materials if not row.left_alone) or "none"
    doubts = []
    found = painted(materials, [entry.materials for entry in paint])
    for k, entry in enumerate(paint):
        for pattern in entry.materials:
            alike = [row for row in materials if matches(row.name, pattern)]
            if not alike:
                doubts.append(f"paint: {pattern!r} matches no material; those that can be painted: {names}")
            elif not any(row.name in found for row in alike):
                why = f"{alike[0].name!r} is left alone, {alike[0].left_alone}"
                doubts.append(f"paint: {pattern!r} paints nothing: {why}; give its whole name if it is to be painted")
        if entry.materials and k not in found.values() and not any("paint:" in doubt for doubt in doubts):
            doubts.append(f"paint: an earlier entry has all materials of {list(entry.materials)}")
    return doubts


def paint_notes(paint: Sequence[PaintEntry], materials: Sequence[MaterialRow]) -> list[str]:
    """What a vehicle's `paint` does, a line for each entry."""
    found = painted(materials, [entry.materials for entry in paint])
    lines = []
    for k, entry in enumerate(paint):
        on = ", ".join(name for name, which in found.items() if which == k) or "nothing"
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
