"""The paint of a vehicle in a row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta, Struct

from hulldown.reading.pieces.naming import name_matches_pattern


class Coat(Struct, frozen=True, gc=False):
    """The paint of some materials of a vehicle in an image."""

    # patterns of names; the first coat that matches a material applies to it
    materials: list[Annotated[str, Meta(max_length=4096)]]
    color: Annotated[str, Meta(pattern="^#[0-9a-f]{6}$")] | None = None  # sRGB; None for the file's own


def color_of_material(name: str, coats: Sequence[Coat]) -> str | None:
    """Return the sRGB color that a material is painted in; None if it keeps its own."""
    return next((coat.color for coat in coats if any(name_matches_pattern(name, pattern) for pattern in coat.materials)), None)
