"""The expected sky in a picture: an HDRI through fog, white balance, exposure, and the view transform."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from hulldown.camera import fog
from hulldown.camera.backdrop import HIGH, even_color, fade
from hulldown.camera.response import displayed, white_balance
from hulldown.camera.weather_kinds import air_layers, airlight

_ERODED = 1  # pixels around other things, such as leaves and wires that rays miss
_SMOOTHED = 5  # pixels: a small map has no finer details


def pictured(
    radiance: Float[np.ndarray, "*n 3"], *, exposure_ev: float, white_balance_k: float
) -> Float[np.ndarray, "*n 3"]:
    """Levels from 0 to 255 of radiance in a picture with an exposure and white balance; see `planning.row`."""
    return displayed(radiance @ white_balance(white_balance_k).T * 2.0**exposure_ev)


def radiance(
    sky: Float[np.ndarray, "m k 3"],
    along: Float[np.ndarray, "*n 3"],
    *,
    yaw: float,
    strength: float,
    visibility_m: float | None = None,
    kind: str = "fog",
    horizon_deg: float | None = None,
) -> Float[np.ndarray, "*n 3"]:
    """Radiance of a sky along rays.

    Parameters
    ----------
    sky
        Equirectangular map of radiance, the zenith in the first row, +x in the middle.
    along
        Unit directions in the scenery's frame.
    yaw
        Yaw of the sky in radians, counterclockwise seen from above.
    strength
        Factor on its radiance.
    visibility_m
        Of the weather, if there is any.
    kind
        Of the weather.
    horizon_deg
        Elevation whose color continues below; None: the sky is unchanged. See `camera.backdrop`.
    """
    height, width = sky.shape[:2]
    x, y, z = np.moveaxis(along, -1, 0)
    column = (0.5 - (np.arctan2(y, x) - yaw) / (2.0 * np.pi)) * width
    elevation = np.arctan2(z, np.hypot(x, y))
    horizon = None if horizon_deg is None else math.radians(horizon_deg)
    if horizon is not None:
        elevation = np.maximum(elevation, horizon)
    row = (0.5 - elevation / np.pi) * height
    seen = sky[np.clip(row.astype(int), 0, height - 1), np.floor(column).astype(int) % width] * strength
    if horizon is not None and horizon > HIGH:
        low, high = fade(horizon)
        share = np.clip((high - z) / (high - low), 0.0, 1.0)[..., None]
        seen = (1.0 - share) * seen + share * even_color(sky, horizon) * strength
    if visibility_m is None:
        return seen
    depth = np.zeros(along.shape[:-1])
    for layer in air_layers(kind, visibility_m):
        down = np.where(z > 0.0, layer.above, layer.reach)
        with np.errstate(divide="ignore"):
            sides = np.stack([layer.reach / np.abs(x), layer.reach / np.abs(y), down / np.abs(z)])
        depth += layer.extinction * sides.min(axis=0)
    clear = np.exp(-depth)[..., None]
    return clear * seen + (1.0 - clear) * airlight(kind, fog.even_sky(sky)) * strength


def inner(sky: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels of sky that aren't next to anything else."""
    return ndimage.binary_erosion(sky, iterations=_ERODED, border_value=1)


def deviation(
    picture: Float[np.ndarray, "h w 3"], expected: Float[np.ndarray, "h w 3"], where: Bool[np.ndarray, "h w"]
) -> float:
    """Median difference from the expected sky over some pixels, in the largest channel, smoothed; of 255."""
    difference = (picture - expected) * where[..., None]
    share = ndimage.uniform_filter(where.astype(np.float64), _SMOOTHED)[where]
    smooth = ndimage.uniform_filter(difference, (_SMOOTHED, _SMOOTHED, 0))[where] / share[:, None]
    return float(np.median(np.abs(smooth).max(axis=1)))
