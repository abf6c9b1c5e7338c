"""Read an HDRI with Blender, check it, and write a repaired copy if needed."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from jaxtyping import Float

from hulldown.assets.skylight import SkyLight, level_irradiance
from hulldown.base.errors import AssetError
from hulldown.blender.buffers import image_pixels
from hulldown.reading.hdri import MENDED_NAME, FoundSky, mended_radiance_and_repairs
from hulldown.reading.reader_process import Job
from hulldown.reading.surroundings import backdrop_elevation_and_misfits, shows_land, shrink_sky_map


def run_hdri_job(job: Job) -> FoundSky:
    """Check an HDRI; write a repaired copy if needed."""
    image = bpy.data.images.load(str(Path(job.path).resolve()))
    try:
        radiance, notes = mended_radiance_and_repairs(_image_radiance(image))
    finally:
        bpy.data.images.remove(image)
    mended = hashlib.sha256(np.ascontiguousarray(radiance, "<f4").tobytes()).hexdigest() if notes else ""
    if notes:
        _write_radiance_exr(radiance, str(job.file(MENDED_NAME)))
    red, green, blue = level_irradiance(radiance).tolist()
    small = shrink_sky_map(radiance)
    return FoundSky(SkyLight((red, green, blue), *backdrop_elevation_and_misfits(small), shows_land(small)), notes, mended)


def _image_radiance(image: Any) -> Float[np.ndarray, "h w 3"]:
    """Return radiance in linear Rec. 709, converted from the file's color space; the first row is the lowest."""
    if not all(image.size) or not image.channels:
        what = "it has several layers" if image.type == "MULTILAYER" else "damaged, or of an unknown kind"
        raise AssetError(f"Blender cannot read this picture ({what})", remedy="save it again, or leave it out")
    return image_pixels(image)[..., :3]


def _write_radiance_exr(radiance: Float[np.ndarray, "h w 3"], path: str) -> None:
    height, width = radiance.shape[:2]
    image = bpy.data.images.new("mended", width, height, float_buffer=True, is_data=True)
    full = np.ones((height, width, 4), dtype=np.float32)
    full[..., :3] = radiance
    image.pixels.foreach_set(full.ravel())
    image.filepath_raw, image.file_format = path, "OPEN_EXR"
    image.save()
    bpy.data.images.remove(image)
