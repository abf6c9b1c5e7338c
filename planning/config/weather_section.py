"""The config's `[weather]`: shares and ranges of each kind."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field, model_validator

from hulldown.camera.weather.extinction import GHOST
from hulldown.camera.weather.kinds import KINDS
from hulldown.planning.config.section import Pair, Section, Share, ranged

Covers = Annotated[Pair, ranged(0.0, 1.0)]
Visibilities = Annotated[Pair, ranged(1.0, 1e6)]


class WeatherSection(Section):
    """Shares of images with each kind of weather, and its ranges; the other images are clear."""

    fog: Share = 0.0
    """share of images with fog"""
    rain: Share = 0.0
    """share with rain"""
    snow: Share = 0.0
    """share with falling snow"""
    dust: Share = 0.0
    """share with blown dust"""
    visibility_m: Visibilities = (300.0, 3000.0)
    """visibility in fog, meters; 3000 is haze"""
    rain_mm_h: Annotated[Pair, ranged(0.1, 300.0)] = (2.0, 50.0)
    """rate of rain, mm/h: 2 is light, 10 heavy, 50 a cloudburst"""
    snow_visibility_m: Visibilities = (300.0, 2000.0)
    """visibility in falling snow, meters"""
    dust_visibility_m: Visibilities = (200.0, 2000.0)
    """visibility in blown dust, meters"""
    snow_cover: Covers = (0.3, 1.0)
    """share of the ground under snow"""
    vehicle_snow_cover: Covers = (0.0, 0.8)
    """share of a vehicle's upper faces under snow"""
    dust_cover: Covers = (0.0, 0.5)
    """share of the ground under dust"""
    vehicle_dust_cover: Covers = (0.1, 0.8)
    """share of a vehicle's lower parts under dust"""
    wind_m_s: Annotated[Pair, ranged(0.0, 60.0)] = (0.0, 8.0)
    """wind in rain, snow, and dust, from any direction, m/s"""
    exposure_s: float = Field(default=0.004, gt=0, le=10)
    """shutter time, seconds: the length of streaks"""
    min_contrast: Share = GHOST
    """contrast that a target must keep after haze; 0 allows ghosts"""

    @model_validator(mode="after")
    def _shares_of_one_whole(self) -> WeatherSection:
        total = math.fsum(getattr(self, name) for name in KINDS)
        if total > 1.0 + 1e-9:
            raise ValueError(f"{', '.join(KINDS)} are {total:g} together; expected shares of at most 1 in all")
        return self
