"""How an HDRI lights open land, as a few thousand numbers: what each patch of its sky adds to the light there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

BANDS, SECTORS = 32, 64  # of the patches, from the horizon up and around it


@dataclass(frozen=True, eq=False, slots=True)
class SkyLight:
    """The light of a sky on level ground, patch by patch; their sum is exact however many patches there are.

    Parameters
    ----------
    irradiance
        (k, 3) what each patch adds to the irradiance of level ground, linear Rec. 709.
    direction
        (k, 3) unit vectors to where that comes from, in the sky's own frame: +x is the middle of the picture.
    horizon_deg
        Elevation up to which something other than sky is seen.
    misfits
        What tells that it does not show open land, a sentence each.
    """

    irradiance: Float[np.ndarray, "k 3"]
    direction: Float[np.ndarray, "k 3"]
    horizon_deg: float = 0.0
    misfits: tuple[str, ...] = ()

    @property
    def clear(self) -> Float[np.ndarray, "3"]:
        """Irradiance of level ground in clear air."""
        return np.asarray(self.irradiance.sum(axis=0))


def sky_light(
    pixels: Float[np.ndarray, "h w 3"], *, bands: int = BANDS, sectors: int = SECTORS
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Irradiance and direction of the patches of an equirectangular picture; see `SkyLight`.

    Between the centres of its pixels a picture is linear, as it is rendered. Every pixel counts with the integral of
    its share of that over the upper hemisphere, cosine included, in closed form.

    Parameters
    ----------
    pixels
        Linear Rec. 709, the lowest row first, +x in the middle, +y to the left of it.
    bands, sectors
        Patches from the horizon up, and around it.
    """
    height, width = pixels.shape[:2]
    low = max(0, height // 2 - 1)  # the row below the horizon reaches above it
    upper, weights = pixels[low:], row_weights(height)[low:] * (2.0 * math.pi / width)
    elevation = np.maximum((np.arange(low, height) + 0.5) / height * math.pi - math.pi / 2.0, 0.25 * math.pi / height)
    azimuth = math.pi - (np.arange(width) + 0.5) / width * 2.0 * math.pi
    columns = np.unique(np.arange(sectors) * width // sectors)
    rows = np.unique(np.arange(bands) * (height - low) // bands)

    def patches(values: Float[np.ndarray, "r s 3"]) -> Float[np.ndarray, "k 3"]:
        return np.add.reduceat(values * weights[:, None, None], rows, axis=0).reshape(-1, 3)

    light = np.add.reduceat(upper, columns, axis=1, dtype=np.float64)
    grey = upper.sum(axis=2, dtype=np.float64)
    east, north, all_ = (
        np.add.reduceat(grey * factor, columns, axis=1) for factor in (np.cos(azimuth), np.sin(azimuth), 1.0)
    )
    flat, up = np.cos(elevation)[:, None], np.sin(elevation)[:, None]
    towards = patches(np.stack([flat * east, flat * north, up * all_], axis=2))
    length = np.linalg.norm(towards, axis=1, keepdims=True)
    zenith = np.array([0.0, 0.0, 1.0])
    return patches(light), np.where(length > 0.0, towards / np.maximum(length, 1e-300), zenith)


def row_weights(height: int) -> Float[np.ndarray, " h"]:
    """What a row of an equirectangular picture, the lowest first, adds to the light on level ground, per radian.

    The integral of sin(e) cos(e) times the row's hat function, which is 1 at its centre and 0 at its neighbours'.
    """
    step = math.pi / height
    centre = (np.arange(height) + 0.5) * step - math.pi / 2.0

    def integral(low: Float[np.ndarray, " h"], high: Float[np.ndarray, " h"], slope: float) -> Float[np.ndarray, " h"]:
        low, high = (np.clip(end, 0.0, math.pi / 2.0) for end in (low, high))
        at = [(-np.cos(2.0 * e) / 4.0, np.sin(2.0 * e) / 8.0 - e * np.cos(2.0 * e) / 4.0) for e in (low, high)]
        constant, linear = (end - start for start, end in zip(*at, strict=True))
        return (1.0 - slope * centre) * constant + slope * linear

    return integral(centre - step, centre, 1.0 / step) + integral(centre, centre + step, -1.0 / step)


def even_sky(radiance: float = 1.0) -> SkyLight:
    """A sky of one radiance everywhere."""
    return SkyLight(*sky_light(np.full((4 * BANDS, 2 * SECTORS, 3), radiance)))
