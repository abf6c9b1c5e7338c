"""White balance, Blender's view transform, and the exposure at which a gray card is mid-gray.

T. Sobotka, AgX, https://github.com/sobotka/AgX, 2022; in Blender since 4.0 with matrices and a curve of its own.
CIE 15, Colorimetry, 2004: the daylight locus. K. M. Lam, Metamerism and color constancy, PhD thesis, University of
Bradford, 1985: the cone responses that white balance scales.
"""

from __future__ import annotations

import math

import numpy as np

from hulldown.base.color import LUMINANCE_WEIGHTS, srgb_from_linear

CARD_ALBEDO = 0.18  # the gray card's
CARD_LEVEL = 117.64  # of 255: a neutral radiance of 0.18 in a picture of Blender 5.0; 118 in whole levels
NEUTRAL_LIGHT_K = 6500.0  # Blender's white balance leaves this light white
MIN_BALANCE_ERROR_K, MAX_BALANCE_ERROR_K = -2500.0, 13500.0  # the daylight locus reaches no further
MAX_EV = 32.0  # Blender's view settings allow no more

# Blender's AgX without a look: matrix, curve over 16.5 stops, matrix, sRGB. Fitted to 3000 colors that Blender 5.0 has
# transformed, from 2^-9 to 2^6 and up to saturated; on 3144 others the largest error of a channel is 1.5 of 255 in the
# mean, below 4.5 for 99 %.
_AGX_IN = np.array([[0.48953, 0.25038, 0.07277], [0.08819, 0.63193, 0.0971], [0.07342, 0.14333, 0.59868]])
_AGX_OUT = np.array([[27.72894, -9.143, -2.25037], [-2.71474, 19.84961, -0.85207], [-2.60696, -3.90831, 22.83187]])
_AGX_CURVE = (-8.86642, 39.66201, -61.55681, 36.89593, -1.72526, -6.12759, 2.24129, -0.22737)
_MIN_STOP, _STOP_RANGE = -12.47393, 16.5
_LEVEL_POWER = 2.2
_EXPOSURE_HALVINGS = 48  # they narrow the range of exposures to 1e-13 EV
_XYZ_FROM_RGB = np.array([[0.41239, 0.35758, 0.18048], [0.21264, 0.71517, 0.07219], [0.01933, 0.11919, 0.95053]])
_BLACK_BODY = ((0.5267, 0.4133), (0.4770, 0.4137), (0.4369, 0.4041))  # xy at 2000, 2500, and 3000 K
_CONES_FROM_RGB = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]) @ _XYZ_FROM_RGB


def display_levels(radiance: np.ndarray) -> np.ndarray:
    """Levels from 0 to 255 of linear Rec. 709 radiance in a picture."""
    stops = (np.log2(np.maximum(radiance @ _AGX_IN.T, 1e-10)) - _MIN_STOP) / _STOP_RANGE
    curved = np.polyval(_AGX_CURVE, np.clip(stops, 0.0, 1.0))
    linear = np.clip(np.sign(curved) * np.abs(curved) ** _LEVEL_POWER @ _AGX_OUT.T, 0.0, 1.0)
    return 255.0 * srgb_from_linear(linear)


def white_balance_matrix(offset_k: float) -> np.ndarray:
    """Matrix on linear Rec. 709 of a camera whose white balance is off by some kelvin.

    `offset_k`: offset of its setting from `NEUTRAL_LIGHT_K`; 0 changes nothing, and more makes pictures warmer.

    >>> red, _, blue = white_balance_matrix(1000.0).sum(axis=1)
    >>> bool(red > 1.0 > blue)
    True
    """
    if offset_k == 0.0:
        return np.eye(3)
    cones = _CONES_FROM_RGB @ np.linalg.inv(_XYZ_FROM_RGB)
    seen, wanted = (cones @ _daylight_xyz(kelvin) for kelvin in (NEUTRAL_LIGHT_K + offset_k, NEUTRAL_LIGHT_K))
    return np.linalg.inv(_CONES_FROM_RGB) @ np.diag(wanted / seen) @ _CONES_FROM_RGB


def _daylight_xyz(kelvin: float) -> np.ndarray:
    """XYZ of daylight with luminance 1, for a color temperature from 4000 to 25000 K."""
    t = 1000.0 / kelvin
    cool, warm = ((0.244063, 0.09911, 2.9678, -4.6070), (0.237040, 0.24748, 1.9018, -2.0064))
    x = float(np.polyval((cool if kelvin <= 7000.0 else warm)[::-1], t))
    return _chromaticity_xyz(x, -3.0 * x * x + 2.870 * x - 0.275)


def _chromaticity_xyz(x: float, y: float) -> np.ndarray:
    return np.array([x / y, 1.0, (1.0 - x - y) / y])


def distance_from_daylight(light: np.ndarray, *, warmest: float = 2000.0) -> float:
    """Return the distance of a light's color from sunsets and daylight in CIE 1976 u'v'; 0 for 2000 to 25000 K.

    `light`: linear Rec. 709; not black.

    >>> import numpy as np
    >>> distance_from_daylight(np.ones(3)) < 0.01 < distance_from_daylight(np.array([0.1, 0.1, 1.0]))
    True
    """
    kelvins = (4000.0, 4500.0, 5000.0, 5500.0, 6500.0, 8000.0, 12000.0, 25000.0)
    daylight = [_daylight_xyz(kelvin) for kelvin in kelvins if kelvin >= warmest]
    sunsets = [_chromaticity_xyz(x, y) for x, y in _BLACK_BODY if warmest < 4000.0]
    places = np.stack([_uv_from_xyz(color) for color in (*sunsets, *daylight)])
    place, start, along = _uv_from_xyz(_XYZ_FROM_RGB @ light), places[:-1], np.diff(places, axis=0)
    share = np.clip(((place - start) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(start + share[:, None] * along - place, axis=1).min())


def _uv_from_xyz(xyz: np.ndarray) -> np.ndarray:
    """CIE 1976 u'v' of XYZ."""
    x, y, z = xyz
    return np.array([4.0 * x, 9.0 * y]) / (x + 15.0 * y + 3.0 * z)


def metered_exposures_ev(radiance: np.ndarray) -> np.ndarray:
    """Exposures in EV at which gray cards of this radiance have `CARD_LEVEL` in a picture; the maximum for black."""
    low, high = (np.full(len(radiance), end) for end in (-MAX_EV, MAX_EV))
    for _ in range(_EXPOSURE_HALVINGS):
        middle = (low + high) / 2.0
        dark = display_levels(radiance * np.exp2(middle)[:, None]) @ LUMINANCE_WEIGHTS < CARD_LEVEL
        low, high = np.where(dark, middle, low), np.where(dark, high, middle)
    return (low + high) / 2.0


def gray_card_radiance(irradiance: np.ndarray, strength: float | np.ndarray) -> np.ndarray:
    """Return the radiance of a level gray card on open land under HDRIs of this irradiance (n, 3) and strength.

    In linear Rec. 709. It doesn't depend on the sky's rotation and the weather: in renders, fog doesn't dim the light
    on the ground near the camera (docs/benchmarks.md).
    """
    return np.asarray(irradiance * (CARD_ALBEDO / math.pi * strength))
