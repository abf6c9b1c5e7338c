"""What is in the air and lies on things in an image: fog, rain, snow or dust."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

Kind = Literal["fog", "rain", "snow", "dust"]
Cover = Annotated[float, Meta(ge=0, le=1)]
Wind = Annotated[float, Meta(ge=-100, le=100)]


class Weather(Struct, frozen=True, gc=False, omit_defaults=True):
    """What is in the air and lies on things, of one kind; files leave out what has its default.

    Parameters
    ----------
    visibility_m
        Meteorological visibility: how far one sees through it.
    kind
        What it is.
    rain_mm_h
        Rate of the rain; 0 of other kinds.
    wind_m_s
        Where the wind blows to along the scenery's x and y; it slants what falls.
    exposure_s
        How long the shutter is open: as long falls what leaves a streak.
    ground_cover, vehicle_cover
        How wet, or how far under snow or dust, scenery and vehicles are.
    """

    visibility_m: Annotated[float, Meta(gt=0, le=1e9)]
    kind: Kind
    rain_mm_h: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    wind_m_s: tuple[Wind, Wind] = (0.0, 0.0)
    exposure_s: Annotated[float, Meta(gt=0, le=10)] = 0.004
    ground_cover: Cover = 0.0
    vehicle_cover: Cover = 0.0
