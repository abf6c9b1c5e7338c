"""Texture coordinates of a mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float


def coordinates(mesh: Any, layer: str) -> Float[np.ndarray, "k 2"] | None:
    """Texture coordinates of each face corner, 0 in place of NaN; None if there is no such layer.

    Parameters
    ----------
    mesh
        Of Blender.
    layer
        Its name; "" for the one that is rendered.
    """
    layers = mesh.uv_layers
    found = layers.get(layer) if layer else next((each for each in layers if each.active_render), None)
    if found is None:
        return None
    flat = np.empty(2 * len(found.uv), dtype=np.float32)
    found.uv.foreach_get("vector", flat)
    return np.where(np.isfinite(flat), flat, 0.0).reshape(-1, 2).astype(np.float64)
