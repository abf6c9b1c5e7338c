"""The limits of weather: what a row says of it against what its config allows, and what was drawn."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from camera.weather import rain_visibility_m, wetness
from planning.limit import Limit
from planning.search_limits import METRES, SHARE
from planning.weather import Weather

if TYPE_CHECKING:
    from planning.recomputed import Recomputed

_OF = {
    "visibility_m": ("fog", "visibility_m"),
    "rain_mm_h": ("rain", "rain_mm_h"),
    "snow_visibility_m": ("snow", "visibility_m"),
    "dust_visibility_m": ("dust", "visibility_m"),
    "snow_cover": ("snow", "ground_cover"),
    "vehicle_snow_cover": ("snow", "vehicle_cover"),
    "dust_cover": ("dust", "ground_cover"),
    "vehicle_dust_cover": ("dust", "vehicle_cover"),
}  # key of the config -> which kind of weather, and what it says of it


def _values(
    r: Recomputed, kinds: tuple[str, ...], value: Callable[[Weather], float], key: str
) -> Float[np.ndarray, " n"]:
    """What the rows say; those with other weather keep any limit of it."""
    low = _bounds(r.config, key)[0]
    said = [row.weather for row in r.rows]
    return np.array([value(one) if one is not None and one.kind in kinds else low for one in said], dtype=np.float64)


def _bounds(config: Any, key: str) -> tuple[float, float]:
    said = getattr(config.weather, key)
    return said if isinstance(said, tuple) else (said, said)


def _limit(key: str, kinds: tuple[str, ...], value: Callable[[Weather], float], what: str) -> Limit:
    return Limit(
        f"weather.{key}",
        (f"weather.{key}",),
        f"{what}; images without {' or '.join(kinds)} keep any",
        lambda r: _values(r, kinds, value, key),
        lambda config: _bounds(config, key),
        slack=METRES,
    )


def _follows(weather: Weather | None) -> bool:
    """Whether what follows from the kind and the rate does."""
    if weather is None:
        return True
    if weather.kind != "rain":
        still = weather.kind != "fog" or weather == Weather(weather.visibility_m, "fog")
        return still and weather.rain_mm_h == 0.0
    seen, wet = float(rain_visibility_m(weather.rain_mm_h)), float(wetness(weather.rain_mm_h))
    covers = (weather.ground_cover, weather.vehicle_cover)
    return abs(weather.visibility_m - seen) <= METRES and all(abs(cover - wet) <= SHARE for cover in covers)


def _all_follow(r: Recomputed) -> Bool[np.ndarray, " n"]:
    return np.array([_follows(row.weather) for row in r.rows])


WEATHER_LIMITS = (
    Limit(
        "weather, which is not what was drawn",
        ("weather.fog", "weather.rain", "weather.snow", "weather.dust"),
        "the kind in `weather` against the draw of the image's index",
        lambda r: r.weather_as_drawn,
    ),
    *(_limit(key, (kind,), attrgetter(field), f"`{field}` of `weather`") for key, (kind, field) in _OF.items()),
    _limit(
        "wind_m_s", ("rain", "snow", "dust"), lambda weather: math.hypot(*weather.wind_m_s), "the length of `wind_m_s`"
    ),
    _limit("exposure_s", ("rain", "snow", "dust"), attrgetter("exposure_s"), "`exposure_s` of `weather`"),
    Limit(
        "weather, which does not follow from its kind and rate",
        (),
        "of rain: visibility and both covers, which are how wet things are; of fog: nothing falls and lies",
        _all_follow,
    ),
)
