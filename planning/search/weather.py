"""Weather of each image: its kind, by the shares of kinds, and its numbers."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from hulldown.camera.weather.extinction import rain_visibility_m, wetness
from hulldown.camera.weather.kinds import KINDS, Weather
from hulldown.geometry.portable import sin_cos
from hulldown.plan.config.scene_sections import WeatherSection
from hulldown.plan.row import rounded
from hulldown.planning.search.random_streams import Purpose, RandomStreams, between

NAMES = tuple(KINDS)
CLEAR = len(NAMES)


def draw_weathers(
    weather: WeatherSection, *, draws: RandomStreams, image: Int[np.ndarray, " n"]
) -> list[Weather | None]:
    """Draw the weather of the images with these indices, rounded as in a plan; None where it is clear.

    Kind and visibility have separate random numbers, so that the share of rain doesn't change the fog of images.
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
        rows = kind == k
        windy |= rows & each.windy
        if each.visibility:
            visible[rows] = within(each.visibility, u[rows, 4])
        if each.rate:
            rate[rows] = rounded("weather", within(each.rate, u[rows, 4]))
            visible[rows], covers[:, rows] = rain_visibility_m(rate[rows]), wetness(rate[rows])
        for cover, key, uniform in zip(covers, each.covers, (ground, vehicle), strict=False):
            cover[rows] = within(key, uniform[rows])
    sine, cosine = sin_cos(2.0 * np.pi * turn)
    wind = between(*weather.wind_m_s, speed)[:, None] * np.stack([cosine, sine], axis=1)
    visible, wind = rounded("weather", visible), np.where(windy[:, None], rounded("weather", wind), 0.0)
    columns = (kind, visible, rate, wind, *rounded("weather", covers))
    return [
        None if k == CLEAR else Weather(visibility, NAMES[k], rain, (x, y), weather.exposure_s, on_ground, on_vehicle)
        for k, visibility, rain, (x, y), on_ground, on_vehicle in zip(*(c.tolist() for c in columns), strict=True)
    ]
