"""Weather of each image: which kind, by its share, and how much of it; a function of the seed and the image alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np
from jaxtyping import Bool, Float, Int

from camera.weather import rain_visibility_m, wetness
from geometry.portable import sin_cos
from planning.draws import Draws, Purpose, between
from planning.row import rounded
from planning.weather import Kind, Weather
from planning.weather_section import WeatherSection

KINDS: tuple[Kind, ...] = get_args(Kind)
CLEAR = len(KINDS)
FOG, RAIN, SNOW, DUST = (KINDS.index(kind) for kind in ("fog", "rain", "snow", "dust"))


@dataclass(frozen=True, eq=False, slots=True)
class Air:
    """Weather of n images, rounded as rows have it.

    Parameters
    ----------
    kind
        (n,) index into `KINDS`, or `CLEAR`.
    visibility_m
        (n,) meteorological visibility; nan where it is clear.
    rain_mm_h
        (n,) rate of rain, 0 of other kinds.
    wind_m_s
        (n, 2) along the scenery's x and y.
    ground_cover, vehicle_cover
        (n,) from 0 to 1: how wet, or how far under snow or dust.
    exposure_s
        How long the shutter is open where anything falls.
    """

    kind: Int[np.ndarray, " n"]
    visibility_m: Float[np.ndarray, " n"]
    rain_mm_h: Float[np.ndarray, " n"]
    wind_m_s: Float[np.ndarray, "n 2"]
    ground_cover: Float[np.ndarray, " n"]
    vehicle_cover: Float[np.ndarray, " n"]
    exposure_s: float

    @property
    def overcast(self) -> Bool[np.ndarray, " n"]:
        """Whether it falls from clouds."""
        return (self.kind == RAIN) | (self.kind == SNOW)

    def weathers(self) -> list[Weather | None]:
        """One for each image, None where it is clear."""
        columns = zip(
            self.kind.tolist(), self.visibility_m.tolist(), self.rain_mm_h.tolist(), self.wind_m_s.tolist(),
            self.ground_cover.tolist(), self.vehicle_cover.tolist(), strict=True,
        )  # fmt: skip
        return [
            None
            if kind == CLEAR
            else Weather(visibility, "fog")
            if kind == FOG
            else Weather(visibility, KINDS[kind], rate, (x, y), self.exposure_s, ground, vehicle)
            for kind, visibility, rate, (x, y), ground, vehicle in columns
        ]


def draw_air(weather: WeatherSection, *, draws: Draws, image: Int[np.ndarray, " n"]) -> Air:
    """Weather of the images with these indices.

    Kind and visibility have draws of their own, so that a share of rain changes no fog.
    """
    u = draws.uniform(Purpose.LIGHT, image, 0, count=5)
    speed, turn, ground, vehicle = draws.uniform(Purpose.WEATHER, image, 0, count=4).T
    kind = np.searchsorted(np.cumsum([getattr(weather, each) for each in KINDS]), u[:, 3], side="right")
    rain, dry = kind == RAIN, (kind == FOG) | (kind == CLEAR)
    rate = np.where(rain, rounded("weather", between(*weather.rain_mm_h, u[:, 4])), 0.0)
    wetted = rounded("weather", wetness(rate))
    visible = np.full(len(image), np.nan)
    visible[rain] = rain_visibility_m(rate[rain])
    covers = [np.where(rain, wetted, 0.0) for _ in range(2)]
    for of, metres, lies in (
        (FOG, weather.visibility_m, ()),
        (SNOW, weather.snow_visibility_m, (weather.snow_cover, weather.vehicle_snow_cover)),
        (DUST, weather.dust_visibility_m, (weather.dust_cover, weather.vehicle_dust_cover)),
    ):
        mine = kind == of
        visible[mine] = between(*metres, u[mine, 4])
        for cover, bounds, uniform in zip(covers, lies, (ground, vehicle), strict=False):
            cover[mine] = between(*bounds, uniform[mine])
    sine, cosine = sin_cos(2.0 * np.pi * turn)
    wind = between(*weather.wind_m_s, speed)[:, None] * np.stack([cosine, sine], axis=1)
    return Air(
        kind=kind,
        visibility_m=rounded("weather", visible),
        rain_mm_h=rate,
        wind_m_s=np.where(dry[:, None], 0.0, rounded("weather", wind)),
        ground_cover=rounded("weather", covers[0]),
        vehicle_cover=rounded("weather", covers[1]),
        exposure_s=weather.exposure_s,
    )
