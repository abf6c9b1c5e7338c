"""Writes a small sky in every compression that Blender has, and one in two color spaces.

Run in Blender, with a folder to write into.
"""

import contextlib
import sys
from pathlib import Path

import bpy
import numpy as np

from hulldown.reading.blender.hdri_picture import _write_radiance_exr

WIDTH, HEIGHT = 64, 32


def sky():
    pixels = np.random.default_rng(0).uniform(0.2, 0.8, (HEIGHT, WIDTH, 3)).astype(np.float32)
    pixels[20, 30] = 5000.0
    return pixels


def tinted(folder):
    """The same sky in linear Rec. 709 and in ACEScg, as the files' metadata say."""
    pixels = sky() * np.array([1.0, 0.6, 0.2], dtype=np.float32)
    _write_radiance_exr(pixels, str(folder / "plain.exr"))
    image = bpy.data.images.load(str(folder / "plain.exr"))
    image.colorspace_settings.name = "Linear Rec.709"  # data without a color space isn't converted
    settings = bpy.context.scene.render.image_settings
    settings.file_format, settings.color_depth, settings.color_management = "OPEN_EXR", "32", "OVERRIDE"
    for name, space in (("rec709", "Linear Rec.709"), ("acescg", "ACEScg")):
        settings.linear_colorspace_settings.name = space
        image.save_render(str(folder / f"{name}.exr"), scene=bpy.context.scene)


def main(folder):
    tinted(folder)
    _write_radiance_exr(sky(), str(folder / "sky.exr"))
    for name, value in (("sun", np.inf), ("nan", np.nan)):
        pixels = sky()
        pixels[20, 31:33] = value
        _write_radiance_exr(pixels, str(folder / f"{name}.exr"))
    image = bpy.data.images.load(str(folder / "sky.exr"))
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Raw"
    settings = scene.render.image_settings
    settings.color_management = "FOLLOW_SCENE"
    settings.file_format = "HDR"
    image.save_render(str(folder / "sky.hdr"), scene=scene)
    settings.file_format = "OPEN_EXR"
    for depth in ("16", "32"):
        settings.color_depth = depth
        for codec in settings.bl_rna.properties["exr_codec"].enum_items:
            with contextlib.suppress(TypeError):  # some need 16 bits
                settings.exr_codec = codec.identifier
                image.save_render(str(folder / f"sky_{codec.identifier}_{depth}.exr"), scene=scene)


main(Path(sys.argv[1]))
