"""How air hides what is far away, for the renderer and the preview: Python alone, as it runs in Blender too."""

from __future__ import annotations

import math

CONTRAST_THRESHOLD = 0.02  # of an object at the distance of the visibility; -ln 0.02 = 3.912
# The fog is a box around the camera.
FOG_REACH = 1.5  # visibilities from the camera to the side of the fog: 0.3 % of what is behind shows through
FOG_SIDE = 2000.0  # metres, at most: what an HDRI shows on the horizon is seldom farther away
FOG_ABOVE = 0.25  # visibilities from the camera to its top: the sky overhead keeps 38 %, the horizon nothing
FOG_TOP = 300.0  # metres, at most: haze of kilometres leaves the zenith blue


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
