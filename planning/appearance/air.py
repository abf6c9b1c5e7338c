"""Weather of each image: which kind, by its share, and how much of it; a function of the seed and the image alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.camera.weather import rain_visibility_m, wetness
from hulldown.camera.weather_kinds import KINDS, Weather
from hulldown.geometry.portable import sin_cos
from hulldown.planning.config.weather_section import WeatherSection
from hulldown.planning.row import rounded
from hulldown.planning.search.draws import Purpose, RandomStreams, between

NAMES = tuple(KINDS)
CLEAR = len(NAMES)


@dataclass(frozen=True, eq=False, slots=True)
class Air:
    """Weather of n images, rounded as rows have it.

    Parameters
    ----------
    kind
        (n,) index into `NAMES`, or `CLEAR`.
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
        return np.isin(self.kind, [k for k, kind in enumerate(KINDS.values()) if kind.overcast])

    def weathers(self) -> list[Weather | None]:
        """One for each image, None where it is clear."""
        columns = zip(
            self.kind.tolist(), self.visibility_m.tolist(), self.rain_mm_h.tolist(), self.wind_m_s.tolist(),
            self.ground_cover.tolist(), self.vehicle_cover.tolist(), strict=True,
        )  # fmt: skip
        return [
            None if kind == CLEAR else Weather(visibility, NAMES[kind], rate, (x, y), self.exposure_s, ground, vehicle)
            for kind, visibility, rate, (x, y), ground, vehicle in columns
        ]


def draw_air(weather: WeatherSection, *, draws: RandomStreams, image: Int[np.ndarray, " n"]) -> Air:
    """Weather of the images with these indices.

    Kind and visibility have draws of their own, so that a share of rain changes no fog.
    """
    u = draws.uniform(Purpose.LIGHT, image, 0, count=5)
    speed, turn, ground, vehicle = draws.uniform(Purpose.WEATHER, image, 0, count=4).T
    kind = np.searchsorted(np.cumsum([getattr(weather, name) for name in NAMES]), u[:, 3], side="right")

    def within(key: str, uniform: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        low, high = getattr(weather, key)
        return between(low, high, uniform)

    n = len(image)
    visible, rate, covers, windy = np.full(n, np.nan), np.zeros(n), np.zeros((2, n)), np.zeros(n, dtype=bool)
    for k, each in enumerate(KINDS.values()):
        own = kind == k
        windy |= own & each.windy
        if each.visibility:
            visible[own] = within(each.visibility, u[own, 4])
        if each.rate:
            rate[own] = rounded("weather", within(each.rate, u[own, 4]))
            visible[own], covers[:, own] = rain_visibility_m(rate[own]), wetness(rate[own])
        for cover, key, uniform in zip(covers, each.covers, (ground, vehicle), strict=False):
            cover[own] = within(key, uniform[own])
    sine, cosine = sin_cos(2.0 * np.pi * turn)
    wind = between(*weather.wind_m_s, speed)[:, None] * np.stack([cosine, sine], axis=1)
    return Air(
        kind=kind,
        visibility_m=rounded("weather", visible),
        rain_mm_h=rate,
        wind_m_s=np.where(windy[:, None], rounded("weather", wind), 0.0),
        ground_cover=rounded("weather", covers[0]),
        vehicle_cover=rounded("weather", covers[1]),
        exposure_s=weather.exposure_s,
    )
