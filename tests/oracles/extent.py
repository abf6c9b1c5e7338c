"""Size of points in an image, by their projections."""

import numpy as np

from hulldown.camera.projection import project


def extent(intrinsics, world_from_camera, points_world, measure="height"):
    """Width, height, diagonal, or root of the area in pixels of the box around points; nan if one isn't in front."""
    pixels = project(intrinsics, world_from_camera, points_world).pixels
    width, height = np.moveaxis(pixels.max(axis=-2) - pixels.min(axis=-2), -1, 0)
    sizes = {"width": width, "height": height, "diagonal": np.hypot(width, height), "area": np.sqrt(width * height)}
    return sizes[measure]
