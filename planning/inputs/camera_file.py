"""Read a camera's calibration in OpenCV's or ROS's format as keys of a config."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct

from hulldown.base.errors import ConfigError
from hulldown.base.outside import convert_parsed_value, parse_yaml, read_text
from hulldown.camera.intrinsics import Intrinsics
from hulldown.plan.config.scene_sections import MAX_IMAGE_SIDE_PX, CameraMatrix, Distortion

# Names in files of OpenCV's samples and of ROS, in lower case without underscores.
_MATRIX_KEYS = ("cameramatrix", "k", "intrinsicmatrix", "mtx")
_DISTORTION_KEYS = ("distortioncoefficients", "distcoeffs", "d", "dist")
_SIZE_KEYS = (("imagewidth", "width"), ("imageheight", "height"))
_DISTORTION_MODELS = ("", "plumb_bob", "rational_polynomial")
_REMEDY = "give a calibration of OpenCV or ROS in YAML or JSON"


_Number = Annotated[float, Meta(ge=-1e9, le=1e9)]  # as in a config


class _Numbers(Struct):
    data: _Number | list[_Number | list[_Number]]


def read_calibration_as_config(path: Path) -> dict[str, object]:
    """Return "section.key" -> value of a config; cx and cy grow by the half pixel by which OpenCV's begin later."""
    table = _read_calibration_table(path)
    for inner in ("camera_info", "cam0"):
        if isinstance(found := table.get(inner), Mapping):
            table = found
    named = {str(key).lower().replace("_", ""): value for key, value in table.items()}

    def numbers(names: tuple[str, ...], what: str) -> Float[np.ndarray, " n"]:
        value = next((named[name] for name in names if named.get(name) is not None), None)
        if value is None:
            raise ConfigError(f"has no {what}", path=path, remedy=f"add it as {names[0]!r}")
        try:
            given = value if isinstance(value, Mapping) else {"data": value}
            found = convert_parsed_value(given, _Numbers, strict=False)  # "1e-5" is a text in YAML
            return np.ravel(np.array(found.data, dtype=np.float64))
        except ValueError:
            raise ConfigError(f"its {what} isn't made of numbers within 1e9", path=path, remedy=_REMEDY) from None

    matrix = numbers(_MATRIX_KEYS, "camera matrix")
    size = [numbers((f"image_{names[1]}", *names), f"image {names[1]}") for names in _SIZE_KEYS]
    model = str(named.get("distortionmodel") or "")
    lens = numbers(_DISTORTION_KEYS, "distortion") if any(name in named for name in _DISTORTION_KEYS) else np.zeros(5)
    if model not in _DISTORTION_MODELS or named.get("fisheyemodel") or lens[5:].any():
        problem = (
            f"has a lens of the model {model!r}" if model not in _DISTORTION_MODELS else "has a lens with more coefficients"
        )
        raise ConfigError(problem, path=path, remedy="calibrate with k1, k2, p1, p2, and k3 alone (plumb_bob)")
    if len(matrix) != 9 or matrix[[1, 3, 6, 7]].any() or any(len(side) != 1 or side % 1 for side in size):
        raise ConfigError("its camera matrix isn't [fx, 0, cx, 0, fy, cy, 0, 0, 1]", path=path, remedy=_REMEDY)
    width, height = (int(side[0]) for side in size)
    if not (1 <= width <= MAX_IMAGE_SIDE_PX and 1 <= height <= MAX_IMAGE_SIDE_PX):
        raise ConfigError(f"isn't a camera: {width} x {height} pixels", path=path, remedy="calibrate it again")
    fx, fy, cx, cy = (float(value) for value in matrix[[0, 4, 2, 5]] + np.array([0.0, 0.0, 0.5, 0.5]))
    coefficients = np.pad(lens[:5], (0, max(0, 5 - len(lens)))).tolist()
    try:
        Intrinsics.calibrated(width, height, (fx, fy, cx, cy), coefficients)
    except ValueError as error:
        raise ConfigError(f"isn't a camera: {error}", path=path, remedy="calibrate it again") from None
    values: dict[str, object] = {
        "render.width": width,
        "render.height": height,
        "camera.intrinsics": dict(zip(CameraMatrix.model_fields, (fx, fy, cx, cy), strict=True)),
    }
    if any(coefficients):
        values["camera.distortion"] = dict(zip(Distortion.model_fields, coefficients, strict=True))
    return values


def _read_calibration_table(path: Path) -> Mapping[str, object]:
    text = read_text(path, partial(ConfigError, path=path, remedy=_REMEDY))
    try:
        # OpenCV's first line isn't valid YAML.
        table = parse_yaml(text.partition("\n")[2] if text.startswith("%YAML:") else text)
    except ValueError as error:
        raise ConfigError(f"is neither YAML nor JSON ({error})", path=path, remedy=_REMEDY) from None
    if not isinstance(table, Mapping):
        raise ConfigError("isn't a calibration", path=path, remedy=_REMEDY)
    return table
