"""Linear light, sRGB values, and luminance, with the primaries of Rec. 709; for Blender too: needs numpy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # for linear Rec. 709, and for display values (ITU-R BT.709-6)


def linear_from_srgb(coded: ArrayLike) -> np.ndarray:
    """Return linear light for sRGB values from 0 to 1 (IEC 61966-2-1:1999), in the precision of the values."""
    values = np.asarray(coded)
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0.0) + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(linear: ArrayLike) -> np.ndarray:
    """Return sRGB values from 0 to 1 for linear light; the inverse of `linear_from_srgb`."""
    values = np.asarray(linear)
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 0.0) ** (1 / 2.4) - 0.055)


def linear_rgb_from_hex(name: str) -> tuple[float, float, float]:
    """Return the linear light of an sRGB color "#rrggbb"."""
    red, green, blue = linear_from_srgb([int(name[i : i + 2], 16) / 255 for i in (1, 3, 5)]).tolist()
    return red, green, blue
