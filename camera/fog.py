"""How air hides what is far away, for the renderer and the preview: Python alone, as it runs in Blender too."""

from __future__ import annotations

import math

CONTRAST_THRESHOLD = 0.02  # of an object at the distance of the visibility; -ln 0.02 = 3.912


def extinction(visibility_m: float) -> float:
    """Extinction in 1/m of air through which one sees so many metres.

    References
    ----------
    H. Koschmieder, Theorie der horizontalen Sichtweite, Beitraege zur Physik der freien Atmosphaere 12, 1924.

    Examples
    --------
    >>> round(extinction(1000.0), 6)
    0.003912
    """
    return -math.log(CONTRAST_THRESHOLD) / visibility_m
