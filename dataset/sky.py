"""How a sky must look in a picture: an HDRI along rays, through fog and Blender's view transform.

References
----------
T. Sobotka, AgX, https://github.com/sobotka/AgX, 2022; in Blender since 4.0 with matrices and a curve of its own.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from camera import fog
from camera.fog import BETWEEN, FOG_REACH, FOG_SIDE, extinction, layer_tops

# Blender's AgX without a look: matrix, curve over 16.5 stops, matrix, sRGB. Fitted to 3000 colours that Blender 5.0 has
# transformed, from 2^-9 to 2^6 and up to saturated; on 3144 others the largest error of a channel is 1.5 of 255 in the
# mean, below 4.5 for 99 %.
_IN = np.array([[0.48953, 0.25038, 0.07277], [0.08819, 0.63193, 0.0971], [0.07342, 0.14333, 0.59868]])
_OUT = np.array([[27.72894, -9.143, -2.25037], [-2.71474, 19.84961, -0.85207], [-2.60696, -3.90831, 22.83187]])
_CURVE = (-8.86642, 39.66201, -61.55681, 36.89593, -1.72526, -6.12759, 2.24129, -0.22737)
_LOWEST, _STOPS = -12.47393, 16.5
_POWER = 2.2
_ERODED = 1  # pixels from what is no sky: leaves and wires that rays do not know
_SMOOTHED = 5  # pixels: finer than that is the sky of a small map not known


def displayed(radiance: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Levels from 0 to 255 that linear Rec. 709 radiance has in a picture.

    Examples
    --------
    >>> import numpy as np
    >>> displayed(np.array([[0.0, 0.0, 0.0], [1e3, 1e3, 1e3]])).round().tolist()
    [[0.0, 0.0, 0.0], [255.0, 255.0, 255.0]]
    """
    stops = (np.log2(np.maximum(radiance @ _IN.T, 1e-10)) - _LOWEST) / _STOPS
    curved = np.polyval(_CURVE, np.clip(stops, 0.0, 1.0))
    linear = np.clip(np.sign(curved) * np.abs(curved) ** _POWER @ _OUT.T, 0.0, 1.0)
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    return 255.0 * coded


def radiance(
    sky: Float[np.ndarray, "m k 3"],
    along: Float[np.ndarray, "*n 3"],
    *,
    yaw: float,
    strength: float,
    visibility_m: float | None = None,
    kind: str = "fog",
) -> Float[np.ndarray, "*n 3"]:
    """What rays see of a sky.

    Parameters
    ----------
    sky
        Equirectangular map of radiance, the zenith in the first row, +x in the middle.
    along
        Unit directions in the scenery's frame.
    yaw
        Turn of the sky in radians, counter-clockwise seen from above.
    strength
        Factor on its radiance.
    visibility_m
        Of the weather, if there is any.
    kind
        Of the weather.
    """
    height, width = sky.shape[:2]
    x, y, z = np.moveaxis(along, -1, 0)
    column = (0.5 - (np.arctan2(y, x) - yaw) / (2.0 * np.pi)) * width
    row = (0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi) * height
    seen = sky[np.clip(row.astype(int), 0, height - 1), np.floor(column).astype(int) % width] * strength
    if visibility_m is None:
        return seen
    through, tops = np.zeros(along.shape[:-1]), layer_tops(kind, visibility_m)
    for number, above in enumerate(tops):
        reach = min(FOG_REACH * visibility_m, FOG_SIDE) * (1.0 - BETWEEN * number)
        with np.errstate(divide="ignore"):
            sides = np.stack([reach / np.abs(x), reach / np.abs(y), np.where(z > 0.0, above, reach) / np.abs(z)])
        through += sides.min(axis=0) / len(tops)
    clear = np.exp(-extinction(visibility_m) * through)[..., None]
    return clear * seen + (1.0 - clear) * np.array(fog.airlight(kind, airlight(sky))) * strength


def airlight(sky: Float[np.ndarray, "m k 3"]) -> Float[np.ndarray, "3"]:
    """Radiance of air that is lit by a sky: that of an even sky which lights the ground as brightly."""
    elevation = np.pi / 2.0 - (np.arange(len(sky)) + 0.5) / len(sky) * np.pi
    weight = np.clip(np.sin(elevation), 0.0, None) * np.cos(elevation)
    return weight @ sky.mean(axis=1) / weight.sum()


def inner(sky: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Where a picture shows sky for sure: not beside anything else."""
    return ndimage.binary_erosion(sky, iterations=_ERODED, border_value=1)


def deviation(
    picture: Float[np.ndarray, "h w 3"], expected: Float[np.ndarray, "h w 3"], where: Bool[np.ndarray, "h w"]
) -> float:
    """Median over some pixels of the difference from what is expected, in its largest channel, smoothed; of 255."""
    difference = (picture - expected) * where[..., None]
    share = ndimage.uniform_filter(where.astype(np.float64), _SMOOTHED)[where]
    smooth = ndimage.uniform_filter(difference, (_SMOOTHED, _SMOOTHED, 0))[where] / share[:, None]
    return float(np.median(np.abs(smooth).max(axis=1)))
