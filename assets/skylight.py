"""The light of an HDRI on level ground, and its signs of surroundings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, slots=True)
class SkyLight:
    """The light of an HDRI, and whether it shows surroundings."""

    irradiance: tuple[float, float, float] = (math.pi, math.pi, math.pi)  # of level ground, linear Rec. 709.
    horizon_deg: float = 0.0  # elevation up to which it shows something other than sky
    misfits: tuple[str, ...] = ()  # signs that it doesn't show open land, one sentence each
    shows_land: bool = False  # whether there are grass, trees, or streets below its horizon, instead of one color


EVEN_SKYLIGHT = SkyLight()  # its radiance is 1 everywhere


def level_irradiance(pixels: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "3"]:
    """Irradiance of level ground under equirectangular radiance, lowest row first; exact for linear interpolation."""
    height, width = pixels.shape[:2]
    rows = pixels.sum(axis=1, dtype=np.float64) * (2.0 * math.pi / width)
    return np.asarray(irradiance_row_weights(height) @ rows)


def irradiance_row_weights(height: int) -> Float[np.ndarray, " h"]:
    """Weight per radian of each row, lowest first, in the light on level ground: its hat times sin(e) cos(e)."""
    step = math.pi / height
    center = (np.arange(height) + 0.5) * step - math.pi / 2.0

    def integral(low: Float[np.ndarray, " h"], high: Float[np.ndarray, " h"], slope: float) -> Float[np.ndarray, " h"]:
        low, high = (np.clip(end, 0.0, math.pi / 2.0) for end in (low, high))
        at = [(-np.cos(2.0 * e) / 4.0, np.sin(2.0 * e) / 8.0 - e * np.cos(2.0 * e) / 4.0) for e in (low, high)]
        constant, linear = (end - start for start, end in zip(*at, strict=True))
        return np.asarray((1.0 - slope * center) * constant + slope * linear)

    weights = integral(center - step, center, 1.0 / step) + integral(center, center + step, -1.0 / step)
    weights[-1] += 0.5 - weights.sum()  # the half row above its center
    return weights
