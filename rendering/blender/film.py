"""Develop Cycles' linear light into a picture file through the simulated sensor.

Runs inside Blender; needs numpy, and OpenColorIO and OpenImageIO as Blender ships them.
"""

from __future__ import annotations

import os
import sys
from functools import cache
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from hulldown.camera.response import white_balance
from hulldown.camera.sensor import Sensor
from hulldown.rendering.blender.cycles import VIEW_TRANSFORM, Unusable
from hulldown.rendering.blender.messages import CameraInput
from hulldown.rendering.blender.sensor_simulation import develop


def develop_file(linear: Path, output: Path, sensor: Sensor, camera: CameraInput, *, seed: int, threads: int) -> None:
    """Develop the light in an .exr file into a .jpg, or a .png at a quality of 0."""
    _, oiio = _libraries()
    file = oiio.ImageInput.open(os.fspath(linear))
    radiance = file.read_image(0, 0, 0, 3, "float")
    file.close()
    balance = white_balance(camera.white_balance).astype(np.float32).T
    view = _view()

    def shown(light: np.ndarray) -> np.ndarray:
        light = light @ balance if camera.white_balance else np.ascontiguousarray(light)
        view.applyRGB(light)
        return light

    x, y = camera.intrinsics.center.tolist()
    picture = develop(
        radiance,
        sensor,
        axis=(x, y),
        exposure_ev=camera.exposure,
        seed=seed,
        view=shown,
        threads=threads or os.cpu_count() or 1,
    )
    height, width = picture.shape[:2]
    spec = oiio.ImageSpec(width, height, 3, "uint8")
    if sensor.jpeg_quality:
        spec.attribute("Compression", f"jpeg:{sensor.jpeg_quality}")
    out = oiio.ImageOutput.create(os.fspath(output))
    if not (out.open(os.fspath(output), spec) and out.write_image(picture) and out.close()):
        raise RuntimeError(f"the picture can't be written: {out.geterror()}")


@cache
def _view() -> Any:
    """Blender's own view transform, from linear Rec. 709 to sRGB."""
    ocio, _ = _libraries()
    path = Path(bpy.utils.resource_path("LOCAL"), "datafiles", "colormanagement", "config.ocio")
    transform = ocio.DisplayViewTransform(src="Linear Rec.709", display="sRGB", view=VIEW_TRANSFORM)
    processor = ocio.Config.CreateFromFile(os.fspath(path)).getProcessor(transform)
    # The other optimizations are exact powers, which take as long again, for 0.005 of 255.
    return processor.getOptimizedCPUProcessor(ocio.BIT_DEPTH_F32, ocio.BIT_DEPTH_F32, ocio.OPTIMIZATION_VERY_GOOD)


@cache
def _libraries() -> tuple[Any, Any]:
    """OpenColorIO and OpenImageIO, from the bpy module's own folder."""
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    sys.path.append(os.path.join(bpy.utils.resource_path("LOCAL"), "python", "lib", version, "site-packages"))
    try:
        import OpenImageIO
        import PyOpenColorIO
    except ImportError as error:
        raise Unusable(
            f"Blender {bpy.app.version_string} comes without {error.name}", "use one from blender.org, or no [sensor]"
        ) from None
    return PyOpenColorIO, OpenImageIO
