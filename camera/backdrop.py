"""The backdrop for HDRIs with a high horizon, an even color; runs in Blender too, so it needs numpy only."""

from __future__ import annotations

import math

import numpy as np

HIGH_HORIZON_RADIANS = math.radians(15.0)  # streets, woods, and rooms reach higher; their colors would become streaks
HORIZON_FADE_RADIANS = math.radians(10.0)  # the HDRI fades in over this angle above a high horizon


def backdrop_color(sky: np.ndarray, horizon: float) -> np.ndarray:
    """Return the median radiance (3,) above a horizon, in radians; the zenith is in the first row of `sky`."""
    elevation = math.pi / 2.0 - (np.arange(len(sky)) + 0.5) / len(sky) * math.pi
    nearest = np.abs(elevation - horizon - HORIZON_FADE_RADIANS / 2.0)
    band = (nearest <= HORIZON_FADE_RADIANS / 2.0) | (nearest == nearest.min())
    return np.asarray(np.median(sky[band].reshape(-1, 3), axis=0))


def backdrop_fade_sines(horizon: float) -> tuple[float, float]:
    """Return sines of the elevations between which the even color gives way to the HDRI, linearly in the sine."""
    high = math.sin(min(horizon + HORIZON_FADE_RADIANS, math.pi / 2.0))
    return min(math.sin(horizon), high - 1e-3), high
