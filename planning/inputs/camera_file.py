"""Read a camera's calibration in OpenCV's or ROS's format as keys of a config."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

from hulldown.base.errors import ConfigError
from hulldown.camera.intrinsics import Intrinsics
from hulldown.planning.config.schema import CameraMatrix, Distortion

# Names in files of OpenCV's samples and of ROS, in lower case without underscores.
_MATRIX = ("cameramatrix", "k", "intrinsicmatrix", "mtx")
_DISTORTION = ("distortioncoefficients", "distcoeffs", "d", "dist")
_SIZE = (("imagewidth", "width"), ("imageheight", "height"))
_MODELS = ("", "plumb_bob", "rational_polynomial")
_LARGEST = 1 << 20  # bytes
_REMEDY = "give a calibration of OpenCV or ROS in YAML or JSON"


class _Loader(yaml.SafeLoader):
    """A loader that reads unknown tags, such as OpenCV's for a matrix, as tables."""


_Loader.add_multi_constructor("", lambda loader, _, node: loader.construct_mapping(node, deep=True))


def read_camera(path: Path) -> dict[str, Any]:
    """Return "section.key" -> value of a config with a calibrated camera.

    OpenCV's pixel coordinates start at the center of the first pixel, a config's at its corner, so cx and cy grow by
    half a pixel.

    Raises
    ------
    ConfigError
        If the file can't be read, is incomplete, or has another lens model.
    """
    table = _table(path)
    for inner in ("camera_info", "cam0"):
        if isinstance(table.get(inner), Mapping):
            table = table[inner]
    named = {str(key).lower().replace("_", ""): value for key, value in table.items()}

    def numbers(names: tuple[str, ...], what: str) -> Float[np.ndarray, " n"]:
        value = next((named[name] for name in names if named.get(name) is not None), None)
        if value is None:
            raise ConfigError(f"has no {what}", path=path, remedy=f"add it as {names[0]!r}")
        try:
            flat = np.ravel(np.array(value["data"] if isinstance(value, Mapping) else value, dtype=np.float64))
        except (KeyError, TypeError, ValueError):
            flat = np.array([np.nan])
        if not np.isfinite(flat).all():
            raise ConfigError(f"its {what} isn't made of numbers", path=path, remedy=_REMEDY)
        return flat

    matrix = numbers(_MATRIX, "camera matrix")
    size = [numbers((f"image_{names[1]}", *names), f"image {names[1]}") for names in _SIZE]
    model = str(named.get("distortionmodel") or "")
    lens = numbers(_DISTORTION, "distortion") if any(name in named for name in _DISTORTION) else np.zeros(5)
    if model not in _MODELS or named.get("fisheyemodel") or lens[5:].any():
        problem = f"has a lens of the model {model!r}" if model not in _MODELS else "has a lens with more coefficients"
        raise ConfigError(problem, path=path, remedy="calibrate with k1, k2, p1, p2, and k3 alone (plumb_bob)")
    if len(matrix) != 9 or matrix[[1, 3, 6, 7]].any() or any(len(side) != 1 or side % 1 for side in size):
        raise ConfigError("its camera matrix isn't [fx, 0, cx, 0, fy, cy, 0, 0, 1]", path=path, remedy=_REMEDY)
    width, height = (int(side[0]) for side in size)
    fx, fy, cx, cy = (float(value) for value in matrix[[0, 4, 2, 5]] + np.array([0.0, 0.0, 0.5, 0.5]))
    coefficients = np.pad(lens[:5], (0, max(0, 5 - len(lens)))).tolist()
    try:
        Intrinsics.calibrated(width, height, (fx, fy, cx, cy), coefficients)
    except ValueError as error:
        raise ConfigError(f"isn't a camera: {error}", path=path, remedy="calibrate it again") from None
    values: dict[str, Any] = {
        "render.width": width,
        "render.height": height,
        "camera.intrinsics": dict(zip(CameraMatrix.model_fields, (fx, fy, cx, cy), strict=True)),
    }
    if any(coefficients):
        values["camera.distortion"] = dict(zip(Distortion.model_fields, coefficients, strict=True))
    return values


def _table(path: Path) -> Mapping[str, Any]:
    try:
        if os.path.getsize(path) > _LARGEST:
            raise ConfigError(f"is larger than {_LARGEST >> 20} MiB", path=path, remedy=_REMEDY)
        text = path.read_text(encoding="utf-8")
        # OpenCV's first line isn't valid YAML.
        table = yaml.load(text.partition("\n")[2] if text.startswith("%YAML:") else text, Loader=_Loader)
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", path=path) from None
    except (yaml.YAMLError, ValueError, RecursionError):
        raise ConfigError("is neither YAML nor JSON", path=path, remedy=_REMEDY) from None
    if not isinstance(table, Mapping):
        raise ConfigError("isn't a calibration", path=path, remedy=_REMEDY)
    return table
