"""Render a scene's light into an array."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from hulldown.blender.buffers import image_pixels

PIXEL_FILTER_WIDTH_PX = 0.01  # the smallest that Blender takes


def set_linear_light_output(scene: Any) -> None:
    """Make a scene write scene-linear light."""
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode = "OPEN_EXR", "RGB"
    settings.color_depth, settings.exr_codec = "32", "NONE"


def set_light_at_pixel_centers(scene: Any) -> None:
    """Make a scene write scene-linear light, with all rays through the centers of pixels."""
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", PIXEL_FILTER_WIDTH_PX
    set_linear_light_output(scene)


def render_light(scene: Any) -> np.ndarray:
    """Return the light (h, w, 4), float32, of a scene that writes light; the first row is the lowest."""
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder, "light.exr"))
        bpy.ops.render.render(write_still=True, scene=scene.name)
        image = bpy.data.images.load(scene.render.filepath)
        image.colorspace_settings.name = "Non-Color"
        light = image_pixels(image)
    bpy.data.images.remove(image)
    return light
