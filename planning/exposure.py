"""How the camera of each image is set: exposure and white balance, by its light and with errors as cameras make."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

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


def exposures(rows: Sequence[Row], light: LightSection, assets: Assets, draws: Draws) -> Exposures:
    """What is planned for images with these HDRIs, turns, strengths and weathers, by their indices."""
    u = draws.uniform(Purpose.EXPOSURE, np.array([row.index for row in rows], dtype=np.int64), 0, count=2)
    ev = _metered(rows, assets) if light.exposure == "auto" else np.full(len(rows), light.exposure)
    ev = np.clip(ev + between(*light.exposure_error_ev, u[:, 0]), -FARTHEST_EV, FARTHEST_EV)
    horizons = [assets.sky(row.hdri).horizon_deg if light.backdrop == "sky" else np.nan for row in rows]
    return Exposures(
        ev=rounded("exposure_ev", ev),
        white_balance_k=rounded("white_balance_k", between(*light.white_balance_error_k, u[:, 1])),
        horizon_deg=np.array(horizons, dtype=np.float64),
    )


def expose(rows: Sequence[Row], light: LightSection, assets: Assets, draws: Draws) -> list[Row]:
    """The rows, with the exposure that is planned for each."""
    found = exposures(rows, light, assets, draws)
    columns = zip(found.ev.tolist(), found.white_balance_k.tolist(), found.horizon_deg.tolist(), strict=True)
    return [
        replace(row, exposure_ev=ev, white_balance_k=kelvin, horizon_deg=None if math.isnan(horizon) else horizon)
        for row, (ev, kelvin, horizon) in zip(rows, columns, strict=True)
    ]


def card(row: Row, assets: Assets) -> Float[np.ndarray, "3"]:
    """Radiance of a level grey card on open land in the light of a row, in linear Rec. 709.

    How the sky is turned changes nothing, nor does weather: fog hides what is far away and does not dim the light on
    the ground near the camera, as rendered and measured (docs/benchmarks.md).
    """
    return np.array(assets.sky(row.hdri).irradiance) * (ALBEDO / math.pi * row.strength)


def _metered(rows: Sequence[Row], assets: Assets) -> Float[np.ndarray, " n"]:
    return metered(np.array([card(row, assets) for row in rows]).reshape(-1, 3))
