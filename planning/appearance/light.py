"""Light of each image: HDRI, rotation, and strength."""

from __future__ import annotations

from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Float, Int

from hulldown.geometry.errors import ConfigError
from hulldown.planning.appearance.air import Air
from hulldown.planning.config.schema import LightSection
from hulldown.planning.search.draws import Purpose, RandomStreams, between, choose


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
    air: Air,
    weights: Float[np.ndarray, "2 h"],
    *,
    draws: RandomStreams,
    image: Int[np.ndarray, " n"],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Draw the light of the images with these indices, given their weather; see `hdri_weights` for `weights`.

    Returns
    -------
    (n,) index into the HDRIs' names, radians about the vertical, counterclockwise from above, and factor on the HDRI's
    brightness.
    """
    u = draws.uniform(Purpose.LIGHT, image, 0, count=3)
    usual, cloudy = (choose(of_sky, u[:, 0]) for of_sky in weights)
    yaw = np.radians(between(*light.yaw_deg, u[:, 1]))
    return np.where(air.overcast, cloudy, usual), yaw, between(*light.strength, u[:, 2])
