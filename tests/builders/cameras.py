"""Points that a camera sees."""

import numpy as np

from hulldown.camera.cameras import Cameras
from hulldown.geometry.transforms import transform_points


def unproject(camera: Cameras, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """World points (n, 3) at these pixels (n, 2) and meters (n,) along the optical axis."""
    return transform_points(camera.world_from_camera, camera.lenses.pixel_directions(pixels) * depth[:, None])
