"""Light and weather of each image: an HDRI, its turn and strength, sometimes fog, and Cycles' sample seed."""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Float, Int

from geometry.errors import ConfigError
from planning.draws import Draws, Purpose, between, choose
from planning.schema import LightSection, WeatherSection


@dataclass(frozen=True, eq=False, slots=True)
class Lights:
    """Light and weather of n images.

    Parameters
    ----------
    hdri
        (n,) index into the HDRIs' names.
    yaw
        (n,) radians: turn about the vertical, counter-clockwise seen from above.
    strength
        (n,) factor on the HDRI's brightness.
    visibility_m
        (n,) meteorological visibility; nan without fog.
    sample_seed
        (n,) 0 to 2**31 - 1.
    """

    hdri: Int[np.ndarray, " n"]
    yaw: Float[np.ndarray, " n"]
    strength: Float[np.ndarray, " n"]
    visibility_m: Float[np.ndarray, " n"]
    sample_seed: Int[np.ndarray, " n"]


def hdri_weights(light: LightSection, names: tuple[str, ...]) -> Float[np.ndarray, " h"]:
    """How often each HDRI is drawn beside the others: the weight of the first entry of `light.hdris` that matches.

    Raises
    ------
    ConfigError
        If an entry matches no HDRI, or no HDRI is left with a weight.
    """
    if not light.hdris:
        return np.ones(len(names))
    for choice in light.hdris:
        if not any(fnmatchcase(name, choice.name) for name in names):
            raise ConfigError(
                f"light.hdris: {choice.name!r} matches no HDRI",
                remedy=f"assets.hdris gives {', '.join(names[:8])}{', ...' if len(names) > 8 else ''}",
            )
    weights = np.array([next((c.weight for c in light.hdris if fnmatchcase(n, c.name)), 0.0) for n in names])
    if not weights.any():
        raise ConfigError("light.hdris: all weights are 0", remedy="give at least one HDRI a weight above 0")
    return weights


def draw_lights(
    light: LightSection,
    weather: WeatherSection,
    weights: Float[np.ndarray, " h"],
    *,
    draws: Draws,
    image: Int[np.ndarray, " n"],
) -> Lights:
    """Light and weather of the images with these indices; `weights` are those of `hdri_weights`."""
    u = draws.uniform(Purpose.LIGHT, image, 0, count=5)
    foggy = u[:, 3] < weather.probability
    return Lights(
        hdri=choose(weights, u[:, 0]),
        yaw=np.radians(between(*light.yaw_deg, u[:, 1])),
        strength=between(*light.strength, u[:, 2]),
        visibility_m=np.where(foggy, between(*weather.visibility_m, u[:, 4]), np.nan),
        sample_seed=(draws.bits(Purpose.SAMPLE_SEED, image, 0, count=1)[:, 0] >> np.uint64(33)).astype(np.int64),
    )
