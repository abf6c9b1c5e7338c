"""Whether an HDRI shows open land, as twelve of 31 HDRIs do, and the height of its surroundings above the horizon."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hulldown.base.color import LUMINANCE_WEIGHTS

MAP_ROWS = 128  # 1.4 degrees each
MIN_JUDGED_ROWS = 32
# Darker than this share of the sky so many degrees above it means surroundings; an overcast sky's horizon has a
# third of its zenith.
MIN_DARK_SHARES = {(1.0, 25.0): 0.5, (25.0, 50.0): 0.3}
MAX_BRIGHT_GAP_ROWS = 3  # a street lamp's light, or sky between two branches
MAX_HORIZON_DEG = 60.0  # higher things are overhead
MAX_FAR_HORIZON_DEG = 15.0  # what reaches higher, in a twentieth of all directions, is a street's or a wood's
MAX_SKY_WARMTH = 1.0  # red over blue overhead; the reddest sky had 0.9, rooms from 1.0 to 2.9
MAX_BUSY_SHARE, MIN_BUSY_STEP = 0.3, 0.25  # of neighbors overhead whose logarithms differ so; broken cloud had 0.23

MAX_PLAIN_VARIATION = 0.2  # deviation over mean below the horizon: 0 in painted skies, from 0.7 in photographs


def shows_land(sky: Float[np.ndarray, "m n 3"]) -> bool:
    """Return whether an HDRI shows more than one color below its horizon."""
    elevation = 90.0 - (np.arange(len(sky)) + 0.5) / len(sky) * 180.0
    below = (sky @ LUMINANCE_WEIGHTS)[(elevation < -3.0) & (elevation > -30.0)]
    return bool(below.size and below.std() > MAX_PLAIN_VARIATION * below.mean())


def shrink_sky_map(pixels: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "m n 3"]:
    """Return means over squares of an equirectangular picture, about `MAP_ROWS` high, the zenith in the first row."""
    height, width = pixels.shape[:2]
    step = max(1, height // MAP_ROWS)
    cut = pixels[::-1][: height // step * step, : width // step * step]
    return np.asarray(cut.reshape(height // step, step, width // step, step, 3).mean(axis=(1, 3), dtype=np.float64))


def backdrop_elevation_and_misfits(sky: Float[np.ndarray, "m n 3"]) -> tuple[float, tuple[str, ...]]:
    """Return the elevation in degrees up to which a `shrink_sky_map` shows more than sky, and signs of closed land."""
    height = len(sky)
    if height < MIN_JUDGED_ROWS:  # too coarse to tell
        return round(min(90.0 / height, MAX_HORIZON_DEG), 3), ()
    elevation = 90.0 - (np.arange(height) + 0.5) / height * 180.0
    gray = sky @ LUMINANCE_WEIGHTS
    gray += 1e-6 * gray.mean()
    tops = _dark_top_elevations(gray, elevation)
    misfits = []
    if (near := float(np.quantile(tops, 0.95))) > MAX_FAR_HORIZON_DEG:
        misfits.append(f"its surroundings reach {near:.0f} degrees above its horizon")
    overhead = (elevation > 30.0) & (elevation < 70.0)
    log = np.log(gray)
    steps = np.maximum(np.abs(np.diff(log, axis=0, append=log[-1:])), np.abs(log - np.roll(log, -1, axis=1)))
    if (busy := float((steps[overhead] > MIN_BUSY_STEP).mean())) > MAX_BUSY_SHARE:
        misfits.append(f"{100 * busy:.0f} % of the sky overhead has edges, as roofs and treetops have")
    red, _, blue = np.median(sky[elevation > 45.0].reshape(-1, 3), axis=0).tolist()
    if red > MAX_SKY_WARMTH * blue:
        misfits.append("overhead, it is as warm as a ceiling")
    return round(max(float(tops.max()), 90.0 / height), 3), tuple(misfits)


def _dark_top_elevations(gray: Float[np.ndarray, "m n"], elevation: Float[np.ndarray, " m"]) -> Float[np.ndarray, " n"]:
    """Return the elevation in degrees of the top of dark surroundings in each column."""
    tops = np.zeros(gray.shape[1])
    bright = np.zeros(gray.shape[1], dtype=int)  # rows since the last dark one
    for row in np.flatnonzero((elevation > 0.0) & (elevation < MAX_HORIZON_DEG))[::-1]:
        dark = np.zeros(gray.shape[1], dtype=bool)
        for (low, high), share in MIN_DARK_SHARES.items():
            above = (elevation > elevation[row] + low) & (elevation < elevation[row] + high)
            dark |= gray[row] < share * np.median(gray[above], axis=0)
        dark &= bright <= MAX_BRIGHT_GAP_ROWS
        tops[dark] = elevation[row] + 90.0 / len(gray)
        bright = np.where(dark, 0, bright + 1)
    return tops
