"""Light and weather of each image: HDRI, rotation, strength, air, and Cycles' sample seed."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Float, Int

from hulldown.geometry.errors import ConfigError
from hulldown.planning.appearance.air import Air, draw_air
from hulldown.planning.config.schema import LightSection
from hulldown.planning.config.weather_section import WeatherSection
from hulldown.planning.search.draws import Purpose, RandomStreams, between, choose


@dataclass(frozen=True, eq=False, slots=True)
class Lights:
    """Light and weather of n images.

    Parameters
    ----------
    hdri
        (n,) index into the HDRIs' names.
    yaw
        (n,) radians about the vertical, counterclockwise from above.
    strength
        (n,) factor on the HDRI's brightness.
    air
        Weather of the n images.
    sample_seed
        (n,) 0 to 2**31 - 1.
    """

    hdri: Int[np.ndarray, " n"]
    yaw: Float[np.ndarray, " n"]
    strength: Float[np.ndarray, " n"]
    air: Air
    sample_seed: Int[np.ndarray, " n"]


def hdri_weights(light: LightSection, names: tuple[str, ...]) -> Float[np.ndarray, "2 h"]:
    """Return the weights of HDRIs, in most weather and in rain and snow.

    An HDRI has the weight of the first entry of `light.hdris` that matches. In rain and snow, only HDRIs of
    `light.overcast` are used if it names any, with the weight 1 for those that `light.hdris` doesn't name.

    Raises
    ------
    ConfigError
        If an entry matches no HDRI, or all weights are 0.
    """
    for key, patterns in (("hdris", [choice.name for choice in light.hdris]), ("overcast", light.overcast)):
        for pattern in patterns:
            if not any(fnmatchcase(name, pattern) for name in names):
                raise ConfigError(
                    f"light.{key}: {pattern!r} matches no HDRI",
                    remedy=f"assets.hdris gives {', '.join(names[:8])}{', ...' if len(names) > 8 else ''}",
                )
    listed = [next((c.weight for c in light.hdris if fnmatchcase(name, c.name)), None) for name in names]
    usual = np.array([(0.0 if light.hdris else 1.0) if weight is None else weight for weight in listed])
    if not usual.any():
        raise ConfigError("light.hdris: all weights are 0", remedy="give at least one HDRI a weight above 0")
    if not light.overcast:
        return np.stack([usual, usual])
    cloudy = np.array([1.0 if weight is None else weight for weight in listed])
    cloudy[[not any(fnmatchcase(name, pattern) for pattern in light.overcast) for name in names]] = 0.0
    if not cloudy.any():
        raise ConfigError(
            "light.overcast: all weights are 0", remedy="give one of them a weight above 0 in light.hdris, or none"
        )
    return np.stack([usual, cloudy])


def draw_lights(
    light: LightSection,
    weather: WeatherSection,
    weights: Float[np.ndarray, "2 h"],
    *,
    draws: RandomStreams,
    image: Int[np.ndarray, " n"],
    scene: Int[np.ndarray, " n"],
) -> Lights:
    """Draw light and weather of the images with these indices; see `hdri_weights` for `weights`.

    `scene` is the index of the image whose light and weather each image shares: its own, or the first of its sequence.
    """
    u = draws.uniform(Purpose.LIGHT, scene, 0, count=3)
    air = draw_air(weather, draws=draws, image=scene)
    usual, cloudy = (choose(of_sky, u[:, 0]) for of_sky in weights)
    return Lights(
        hdri=np.where(air.overcast, cloudy, usual),
        yaw=np.radians(between(*light.yaw_deg, u[:, 1])),
        strength=between(*light.strength, u[:, 2]),
        air=air,
        sample_seed=(draws.bits(Purpose.SAMPLE_SEED, image, 0, count=1)[:, 0] >> np.uint64(33)).astype(np.int64),
    )
