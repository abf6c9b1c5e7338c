"""What a config may say about weather: `[weather]`."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field, model_validator

from camera.weather import GHOST
from planning.section import Section, ranged

Share = Annotated[float, Field(ge=0, le=1)]
Covers = Annotated[tuple[float, float], ranged(0.0, 1.0)]
Visibilities = Annotated[tuple[float, float], ranged(1.0, 1e6)]
Rates = Annotated[tuple[float, float], ranged(0.1, 300.0)]
Winds = Annotated[tuple[float, float], ranged(0.0, 60.0)]


class WeatherSection(Section):
    """How often which weather comes, and how much of it; the rest of the images is clear."""

    fog: Share = 0.0
    rain: Share = 0.0
    snow: Share = 0.0
    dust: Share = 0.0
    visibility_m: Visibilities = (300.0, 3000.0)
    rain_mm_h: Rates = (2.0, 50.0)
    snow_visibility_m: Visibilities = (300.0, 2000.0)
    dust_visibility_m: Visibilities = (200.0, 2000.0)
    snow_cover: Covers = (0.3, 1.0)
    vehicle_snow_cover: Covers = (0.0, 0.8)
    dust_cover: Covers = (0.0, 0.5)
    vehicle_dust_cover: Covers = (0.1, 0.8)
    wind_m_s: Winds = (0.0, 8.0)
    exposure_s: Annotated[float, Field(gt=0, le=10)] = 0.004
    min_contrast: Share = GHOST

    @model_validator(mode="after")
    def _shares_of_one_whole(self) -> WeatherSection:
        total = math.fsum((self.fog, self.rain, self.snow, self.dust))
        if total > 1.0 + 1e-9:
            raise ValueError(f"fog, rain, snow and dust are {total:g} together; expected shares of at most 1 in all")
        return self
