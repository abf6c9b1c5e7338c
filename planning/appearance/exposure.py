"""Exposure and white balance of each image, metered from its light, with errors like a camera's."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from hulldown.assets.library import Assets
from hulldown.camera.response import ALBEDO, FARTHEST_EV, metered
from hulldown.planning.config.schema import LightSection
from hulldown.planning.row import rounded
from hulldown.planning.search.draws import Purpose, RandomStreams, between


def exposures(
    image: Int[np.ndarray, " n"],
    hdris: Sequence[str],
    strength: Float[np.ndarray, " n"],
    *,
    light: LightSection,
    assets: Assets,
    draws: RandomStreams,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], list[float | None]]:
    """Return exposure, white balance, and horizon of the images with these indices, rounded as in a plan.

    Returns
    -------
    The exposure in EV, the offset of the white balance in kelvin, and the elevation in degrees whose color replaces the
    HDRI below it, or None. They don't depend on the HDRI's rotation and the weather.
    """
    u = draws.uniform(Purpose.EXPOSURE, image, 0, count=2)
    skies = {name: assets.sky(name) for name in set(hdris)}
    if light.exposure == "auto":
        irradiance = np.array([skies[name].irradiance for name in hdris]).reshape(-1, 3)
        ev = metered(card(irradiance, strength[:, None]))
    else:
        ev = np.full(len(image), light.exposure)
    ev = np.clip(ev + between(*light.exposure_error_ev, u[:, 0]), -FARTHEST_EV, FARTHEST_EV)
    white_balance = rounded("white_balance_k", between(*light.white_balance_error_k, u[:, 1]))
    cut = {
        name: light.backdrop == "sky" or (light.backdrop == "auto" and (sky.shows_land or bool(sky.misfits)))
        for name, sky in skies.items()
    }
    horizon = [float(skies[name].horizon_deg) if cut[name] else None for name in hdris]
    return rounded("exposure_ev", ev), white_balance, horizon


def card(
    irradiance: Float[np.ndarray, "*n 3"], strength: float | Float[np.ndarray, "n 1"]
) -> Float[np.ndarray, "*n 3"]:
    """Radiance of a level gray card on open land under HDRIs of this irradiance and strength, in linear Rec. 709.

    It doesn't depend on the sky's rotation and the weather: in renders, fog doesn't dim the light on the ground near
    the camera (docs/benchmarks.md).
    """
    return np.asarray(irradiance * (ALBEDO / math.pi * strength))
