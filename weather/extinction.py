"""Laws of extinction, contrast, and wetness by rain rate and visibility.

In portable arithmetic (`base.portable`), since the results are in plans.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from hulldown.base.portable import exp, log
from hulldown.weather.kinds import CONTRAST_THRESHOLD, air_extinction

MIN_LABEL_CONTRAST = 0.05  # the World Meteorological Organization's limit of visibility by day
WETTING_RAIN_MM_H = 2.0  # a rain of this rate keeps surfaces at 63 % of the wettest
_MAX_OPTICAL_DEPTH = 700.0  # nothing is left, and an exponential still has a value


def rain_extinction(rate_mm_h: ArrayLike) -> Float[np.ndarray, "..."]:
    """Extinction in 1/m of rain by its rate, in mm/h: 0.365 R^0.63 per km.

    It is the integral of N(D) 2 pi D^2 / 4 over all drops, N(D) = 8000 exp(-4.1 R^-0.21 D) m^-3 mm^-1 of D in mm: a
    drop is much larger than a wavelength, and takes twice its cross-section out of the light. Fits to measurements
    are alike: 0.312 R^0.67.

    J. S. Marshall, W. M. Palmer, The distribution of raindrops with size, Journal of Meteorology 5, 1948.
    D. Atlas, Shorter contribution: optical extinction by rainfall, Journal of Meteorology 10, 1953.

    >>> [round(1000.0 * float(rain_extinction(rate)), 3) for rate in (1.0, 10.0, 100.0)]
    [0.365, 1.557, 6.642]
    """
    return np.asarray(0.365e-3 * exp(0.63 * log(rate_mm_h)))


def rain_visibility_m(rate_mm_h: ArrayLike) -> Float[np.ndarray, "..."]:
    """Return the meteorological visibility in rain of these rates in mm/h."""
    return np.asarray(-np.log(CONTRAST_THRESHOLD) / rain_extinction(rate_mm_h))


def surface_wetness(rate_mm_h: ArrayLike) -> Float[np.ndarray, "..."]:
    """Return the wetness of surfaces, 0 to 1, in rain of these rates: 1 - exp(-R / 2), a choice without a source."""
    return np.asarray(1.0 - exp(-np.asarray(rate_mm_h, dtype=np.float64) / WETTING_RAIN_MM_H))


def air_contrast(visibility_m: ArrayLike, distance_m: ArrayLike) -> Float[np.ndarray, "..."]:
    """Return the share of an object's contrast left after haze at a distance: exp(-3.912 distance / visibility).

    `visibility_m`: meteorological visibility; nan where the air is clear.
    `distance_m`: from the camera, meters.

    H. Koschmieder, Theorie der horizontalen Sichtweite, Beitraege zur Physik der freien Atmosphaere 12, 1924.
    World Meteorological Organization, Guide to Instruments and Methods of Observation (WMO-No. 8), chapter 9: what is
    seen by day keeps 5 % at least (`MIN_LABEL_CONTRAST`).

    >>> air_contrast([1000.0, 1000.0, float("nan")], [0.0, 1000.0, 500.0]).round(6).tolist()
    [1.0, 0.02, 1.0]
    """
    visibility = np.asarray(visibility_m, dtype=np.float64)
    depth = air_extinction(1.0) * np.asarray(distance_m, dtype=np.float64) / visibility
    return exp(-np.clip(np.where(np.isnan(visibility), 0.0, depth), 0.0, _MAX_OPTICAL_DEPTH))
