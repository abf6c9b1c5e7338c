"""The paint of a vehicle in a row."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct


class Coat(Struct, frozen=True, gc=False):
    """The paint of some materials of a vehicle in an image."""

    # patterns of names; the first coat that matches a material applies to it
    materials: list[Annotated[str, Meta(max_length=4096)]]
    color: Annotated[str, Meta(pattern="^#[0-9a-f]{6}$")] | None = None  # sRGB; None for the file's own
    # hue_deg, saturation, value: rotation of the hue, and factors
    hue_deg: Annotated[float, Meta(ge=-180, le=180)] = 0.0
    saturation: Annotated[float, Meta(ge=0, le=10)] = 1.0
    value: Annotated[float, Meta(ge=0, le=10)] = 1.0
