"""Poses as they stand in files: what is refused as none."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

RIGID = 1e-6  # what rotations in a plan that was edited by hand may be off
FARTHEST = 1e9  # meters: beyond, float64 keeps less than the tenth of a micrometer

_Matrix = tuple[tuple[float, float, float, float], ...]


def decoded_pose(kind: type, value: Any) -> np.ndarray:
    """A pose from JSON; what msgspec does not know by itself."""
    assert kind is np.ndarray, kind
    try:
        (a, b, c, x), (d, e, f, y), (g, h, i, z), last = msgspec.convert(value, _Matrix)
    except (msgspec.ValidationError, ValueError, SystemError):  # the last is what an integer beyond all floats raises
        raise ValueError("no 4x4 matrix") from None
    if not (
        abs(a * a + b * b + c * c - 1.0) <= RIGID
        and abs(d * d + e * e + f * f - 1.0) <= RIGID
        and abs(g * g + h * h + i * i - 1.0) <= RIGID
        and abs(a * d + b * e + c * f) <= RIGID
        and abs(a * g + b * h + c * i) <= RIGID
        and abs(d * g + e * h + f * i) <= RIGID
        and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0.0
        and last == (0.0, 0.0, 0.0, 1.0)
        and max(abs(x), abs(y), abs(z)) <= FARTHEST
    ):
        raise ValueError("not rigid")
    return np.array([[a, b, c, x], [d, e, f, y], [g, h, i, z], last])
