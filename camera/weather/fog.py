"""Layers of fog for the renderer and the preview. Runs in Blender too, so it needs numpy only."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

CONTRAST_THRESHOLD = 0.02  # of an object at the distance of the visibility; -ln 0.02 = 3.912
# The fog is a box around the camera.
FOG_REACH = 1.5  # visibilities from the camera to the side of the fog: 0.3 % of what is behind shows through
FOG_SIDE = 2000.0  # meters, at most: what an HDRI shows on the horizon is seldom farther away
FOG_ABOVE = 0.25  # visibilities from the camera to its top: the sky overhead keeps 38 %, the horizon nothing
FOG_TOP = 300.0  # meters, at most: haze of kilometers leaves the zenith blue
DUST_LAYERS = 2  # of equal extinction, whose tops follow an exponential decay with height
# Of thick dust under an even white sky: (1 - s) (1 - 0.139 s) / (1 + 1.17 s), s^2 = (1 - w) / (1 - 0.7 w), where the
# single-scattering albedo w is 0.98 in red, 0.955 in green, 0.93 in blue.
DUST_ALBEDO = (0.56, 0.42, 0.34)


def extinction(visibility_m: float) -> float:
    """Extinction in 1/m of air with this visibility in meters.

    References
    ----------
    H. Koschmieder, Theorie der horizontalen Sichtweite, Beitraege zur Physik der freien Atmosphaere 12, 1924.

    Examples
    --------
    >>> round(extinction(1000.0), 6)
    0.003912
    """
    return -math.log(CONTRAST_THRESHOLD) / visibility_m


class AirLayer(NamedTuple):
    """Air in a box around the camera.

    Parameters
    ----------
    extinction
        In 1/m.
    above, reach
        Meters from the camera to its top, and to its sides and bottom.
    """

    extinction: float
    above: float
    reach: float


def even_sky(sky: np.ndarray) -> np.ndarray:
    """Radiance (3,) of an even sky that lights level ground as brightly as this one.

    Parameters
    ----------
    sky
        (m, k, 3) equirectangular map of radiance, the zenith in the first row.
    """
    elevation = math.pi / 2 - (np.arange(len(sky)) + 0.5) / len(sky) * math.pi
    weight = np.clip(np.sin(elevation), 0.0, None) * np.cos(elevation)
    return np.asarray((sky.mean(axis=1) * weight[:, None]).sum(axis=0) / weight.sum())
