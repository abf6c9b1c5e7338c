"""Points that a camera sees."""

import numpy as np

from hulldown.camera.projection import Camera, directions
from hulldown.geometry.transforms import apply


def unproject(camera: Camera, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """World points (n, 3) at these pixels (n, 2) and meters (n,) along the optical axis."""
    return apply(camera.world_from_camera, directions(camera.intrinsics, pixels) * depth[:, None])
