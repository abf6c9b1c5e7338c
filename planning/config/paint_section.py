"""The config's paint of a vehicle, with doubts and notes about its effect."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from hulldown.planning.config.section import Pair, Section, ranged
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.paintable import MaterialRow, matches, painted

OWN = "own"


def _color(value: object) -> str:
    if isinstance(value, str) and (value == OWN or re.fullmatch("#[0-9a-fA-F]{6}", value)):
        return value.lower()
    raise ValueError("expected a color such as '#4b5320', or 'own' for the file's")


def _several(value: object) -> object:
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


def paint_doubts(paint: Sequence[PaintEntry], materials: Sequence[MaterialRow]) -> list[Doubt]:
    """Return a doubt for each part of a vehicle's `paint` without effect."""
    names = ", ".join(repr(row.name) for row in materials if not row.left_alone) or "none"
    doubts: list[Doubt] = []
    coat_of = painted(materials, [entry.materials for entry in paint])
    for k, entry in enumerate(paint):
        for pattern in entry.materials:
            fitting = [row for row in materials if matches(row.name, pattern)]
            if not fitting:
                doubts.append(
                    Doubt(
                        DoubtKind.PAINT, f"paint: {pattern!r} matches no material; those that can be painted: {names}"
                    )
                )
            elif not any(row.name in coat_of for row in fitting):
                why = f"{fitting[0].name!r} is left alone, {fitting[0].left_alone}"
                doubts.append(
                    Doubt(
                        DoubtKind.PAINT,
                        f"paint: {pattern!r} paints nothing: {why}; give its whole name if it is to be painted",
                    )
                )
        if entry.materials and k not in coat_of.values() and not doubts:
            doubts.append(
                Doubt(DoubtKind.PAINT, f"paint: an earlier entry has all materials of {list(entry.materials)}")
            )
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
