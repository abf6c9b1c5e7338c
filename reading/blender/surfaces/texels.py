"""One channel of an image that Blender holds, as Cycles would look it up."""

from __future__ import annotations

from typing import Any

import numpy as np

from hulldown.geometry.color import LUMINANCE, linear_from_srgb, srgb_from_linear
from hulldown.reading.blender.api.buffers import image_pixels

MOST_PIXELS = 1 << 26  # read at once; of larger images Blender makes a smaller one first


def is_curved(image: Any, channel: str) -> bool:
    """Return whether texels of a channel are sRGB values, which Cycles makes linear after it has interpolated."""
    return channel != "alpha" and image.colorspace_settings.name == "sRGB"


def channel_texels(image: Any, channel: str, *, alpha_used: bool) -> np.ndarray:
    """Texels of a channel, in 255ths where the file has bytes, and in sRGB if `is_curved`.

    `image`: with pixels.
    """
    if image.alpha_mode == "NONE" and channel == "alpha":
        return np.full((1, 1), 255, np.uint8)
    width, height = image.size
    share = min(1.0, (MOST_PIXELS / (width * height)) ** 0.5)
    rgba = image_pixels(image, (int(width * share), int(height * share)))
    if channel == "alpha":
        return _stored_values(rgba[..., 3], image)
    is_data = image.colorspace_settings.is_data or image.colorspace_settings.name in ("Non-Color", "Raw")
    color = rgba[..., :3]
    if not is_data and not alpha_used and image.alpha_mode in ("STRAIGHT", "PREMUL") and not image.is_float:
        color = color * rgba[..., 3:]
    curved = is_curved(image, channel)
    if curved and image.is_float:  # Blender's floats are linear
        color = srgb_from_linear(color)
    if channel != "gray":
        value = color[..., ("red", "green", "blue").index(channel)]
    elif (color == color[..., :1]).all():
        value = color[..., 0]
    else:
        linear = linear_from_srgb(color).astype(np.float32) if curved else color
        value = linear @ LUMINANCE.astype(np.float32)
        value = srgb_from_linear(value) if curved else value
    return _stored_values(value, image)


def _stored_values(values: np.ndarray, image: Any) -> np.ndarray:
    values = np.ascontiguousarray(values)
    return values if image.is_float else np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)
