"""Boxes in distorted images compared with very many points: any lens and view, near plane, image borders."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hulldown.annotate.boxes import FAR, surface_box
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import Camera
from hulldown.tests.oracles.curves import LENSES, dense_extent

SIZES = ((1920, 1080), (640, 480), (1080, 1920))


@given(st.integers(0, 2**63), st.sampled_from(sorted(LENSES)), st.sampled_from(["before", "large", "across"]))
def test_curved_boxes_are_within_a_hundredth_of_a_pixel(seed: int, name: str, kind: str) -> None:
    rng = np.random.default_rng(seed)
    width, height = SIZES[rng.integers(len(SIZES))]
    half = math.radians(rng.uniform(40, 120)) / 2
    while True:  # the widest view that doesn't fold
        f = width / 2 / math.tan(half)
        pinhole = (f, f * rng.uniform(0.9, 1.1), width * rng.uniform(0.35, 0.65), height * rng.uniform(0.35, 0.65))
        try:
            intrinsics = Intrinsics.calibrated(width, height, pinhole, LENSES[name])
            break
        except ValueError:
            half *= 0.9
    middle = np.array([*rng.uniform(-1, 1, 2), 1.0]) * 10 ** rng.uniform(-0.5, 1.5)
    size = 10 ** rng.uniform(-1.5, 1) * np.linalg.norm(middle) * (3 if kind == "large" else 1)
    triangles = middle + rng.normal(size=(rng.integers(1, 7), 3, 3)) * size * rng.uniform(0.05, 1, 3)
    if kind == "across":
        triangles[..., 2] += rng.uniform(-1, 1) * size - middle[2]
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    for frame in (True, False):
        box = surface_box(triangles.reshape(-1, 3), faces, Camera(intrinsics, np.eye(4)), frame=frame)
        wanted = dense_extent(triangles, intrinsics, frame=frame)
        if box is None or wanted is None:
            assert box is None, box
            assert wanted is None, wanted
            continue
        wanted = np.clip(wanted, -FAR, FAR)
        # Next to the near plane, pixels are millions apart.
        tolerance = 0.01 if frame else 0.01 + 1e-4 * np.abs(wanted).max()
        assert np.abs(np.append(box[:2], box[:2] + box[2:]) - wanted).max() <= tolerance
