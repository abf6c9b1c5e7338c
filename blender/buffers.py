"""Blender's data as arrays."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import DTypeLike

# By type of attribute: the property of its elements, how they are stored, how many numbers each.
STORED_TYPES = {
    "FLOAT": ("value", np.float32, 1),
    "INT": ("value", np.int32, 1),
    "BOOLEAN": ("value", np.bool_, 1),
    "INT8": ("value", np.int32, 1),
    "FLOAT_VECTOR": ("vector", np.float32, 3),
    "FLOAT2": ("vector", np.float32, 2),
    "FLOAT_COLOR": ("color", np.float32, 4),
    "BYTE_COLOR": ("color", np.float32, 4),
    "QUATERNION": ("value", np.float32, 4),
    "FLOAT4X4": ("value", np.float32, 16),
    "INT16_2D": ("value", np.int32, 2),
    "INT32_2D": ("value", np.int32, 2),
}


def read_property(elements: Any, name: str, dtype: DTypeLike, width: int = 1) -> np.ndarray:
    """Return a property of all elements of a collection, `width` numbers each, one after the other."""
    values = np.empty(width * len(elements), dtype=dtype)
    elements.foreach_get(name, values)
    return values


def texture_coordinates(mesh: Any, layer: str) -> np.ndarray | None:
    """Texture coordinates (k, 2) of each face corner, 0 for NaN; None without such a layer; "" is the rendered one."""
    layers = mesh.uv_layers
    found = layers.get(layer) if layer else next((each for each in layers if each.active_render), None)
    if found is None:
        return None
    flat = read_property(found.uv, "vector", np.float32, 2)
    return np.where(np.isfinite(flat), flat, 0.0).reshape(-1, 2).astype(np.float64)


def image_pixels(image: Any, size: tuple[int, int] | None = None) -> np.ndarray:
    """Return pixels (h, w, 4), float32, of an image, resized to a width and height; the first row is the lowest."""
    if size and size != tuple(image.size):
        resized = image.copy()
        try:
            resized.scale(*size)
            return image_pixels(resized)
        finally:
            bpy.data.images.remove(resized)
    width, height = image.size
    flat = np.empty(width * height * image.channels, dtype=np.float32)
    image.pixels.foreach_get(flat)
    found = flat.reshape(height, width, image.channels)
    if image.channels == 4:
        return found
    full = np.ones((height, width, 4), dtype=np.float32)
    full[..., :3] = found[..., : 3 if image.channels == 3 else 1]
    return full
