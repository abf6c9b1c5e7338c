"""How the camera of each image is set: exposure and white balance, by its light and with errors as cameras make."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from assets.library import Assets
from camera.response import ALBEDO, FARTHEST_EV, metered
from planning.draws import Draws, Purpose, between
from planning.row import Row, rounded
from planning.schema import LightSection


@dataclass(frozen=True, eq=False, slots=True)
class Exposures:
    """How n images are exposed, and what is seen of their skies; rounded as rows have them.

    Parameters
    ----------
    ev
        (n,) exposure.
    white_balance_k
        (n,) offset of the white balance.
    horizon_deg
        (n,) elevation whose colour is seen below it; nan where the HDRI is seen as it is.
    """

    ev: Float[np.ndarray, " n"]
    white_balance_k: Float[np.ndarray, " n"]
    horizon_deg: Float[np.ndarray, " n"]


def exposures(
    image: Int[np.ndarray, " n"],
    hdris: Sequence[str],
    strength: Float[np.ndarray, " n"],
    *,
    light: LightSection,
    assets: Assets,
    draws: Draws,
) -> Exposures:
    """Exposures of the images with these indices, HDRIs and strengths; turn and weather change nothing."""
    u = draws.uniform(Purpose.EXPOSURE, image, 0, count=2)
    if light.exposure == "auto":
        sky = {name: np.array(assets.sky(name).irradiance) for name in set(hdris)}
        ev = metered(_card(np.array([sky[name] for name in hdris]).reshape(-1, 3), strength[:, None]))
    else:
        ev = np.full(len(image), light.exposure)
    ev = np.clip(ev + between(*light.exposure_error_ev, u[:, 0]), -FARTHEST_EV, FARTHEST_EV)
    horizon = {name: assets.sky(name).horizon_deg if light.backdrop == "sky" else np.nan for name in set(hdris)}
    return Exposures(
        ev=rounded("exposure_ev", ev),
        white_balance_k=rounded("white_balance_k", between(*light.white_balance_error_k, u[:, 1])),
        horizon_deg=np.array([horizon[name] for name in hdris], dtype=np.float64),
    )


def card(row: Row, assets: Assets) -> Float[np.ndarray, "3"]:
    """Radiance of a level grey card on open land in the light of a row, in linear Rec. 709.

    How the sky is turned changes nothing, nor does weather: fog hides what is far away and does not dim the light on
    the ground near the camera, as rendered and measured (docs/benchmarks.md).
    """
    return _card(np.array(assets.sky(row.hdri).irradiance), row.strength)


def _card(
    irradiance: Float[np.ndarray, "*n 3"], strength: float | Float[np.ndarray, "n 1"]
) -> Float[np.ndarray, "*n 3"]:
    return np.asarray(irradiance * (ALBEDO / math.pi * strength))
