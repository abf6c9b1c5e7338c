"""The config's paint of a vehicle."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated

from pydantic import BeforeValidator, Field

from hulldown.planning.config.section import Section
from hulldown.reading.pieces.asset_report import MaterialRow
from hulldown.reading.pieces.naming import is_named

OWN = "own"


def _color(value: object) -> str:
    if isinstance(value, str) and (value == OWN or re.fullmatch("#[0-9a-fA-F]{6}", value)):
        return value.lower()
    raise ValueError("expected a color such as '#4b5320', or 'own' for the file's")


def _several(value: object) -> object:
    return [value] if isinstance(value, dict) else value


class PaintEntry(Section):
    """Patterns of a vehicle's materials, and their colors."""

    materials: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    """patterns of materials to paint; the first table that matches applies"""
    colors: Annotated[tuple[Annotated[str, BeforeValidator(_color)], ...], Field(strict=False, min_length=1)]
    """sRGB colors such as "#4b5320", of which one is drawn, or "own", the file's"""


Paint = Annotated[tuple[PaintEntry, ...], BeforeValidator(_several), Field(strict=False)]


def unmatched_pattern(paint: Sequence[PaintEntry], materials: Sequence[MaterialRow]) -> str | None:
    """Return the first pattern of a vehicle's `paint` that matches none of its materials."""
    patterns = [pattern for entry in paint for pattern in entry.materials]
    return next((p for p in patterns if not any(is_named(row.name, p) for row in materials)), None)
