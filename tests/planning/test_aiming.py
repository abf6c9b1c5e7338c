"""Cameras are drawn as configured: every direction, distance, and framing has its stated distribution.

On a bare plane nothing is rejected, so a plan has the drawn values. Seeds are fixed, so a failure is a change.
"""

import functools
import itertools
import json
import math

import numpy as np
import pytest
from scipy import stats

from hulldown.camera.intrinsics import Intrinsics
from hulldown.tests.builders.planning_assets import bare, plan, small_assets, small_config, to_camera

N = 600
ASSETS = small_assets(bare("bare"), vehicles=["t72"])
TANK = ASSETS.vehicles["t72"]
FRACTION, FACTOR = 0.15, 2.0
FOUR = {"distance_factor": [1.0, 4.0]}


@functools.cache
def rows(options):
    camera = {
        "fov_x_deg": [40, 60], "target_fraction": FRACTION, "distance_factor": FACTOR, "elevation_deg": [10, 60],
        "visible_fraction": [0, 1], "min_box_px": 0, "visibility_rays": 1, "framing": 1.0, **json.loads(options),
    }  # fmt: skip
    found = list(plan(small_config(budget={"images_per_class": N, "images_per_position": 3}, camera=camera), ASSETS))
    assert all(row.rejected == {} for row in found)
    return found


def drawn(options):
    """For each image: the camera's distance over S f / H, angles, field of view, and place in the frame."""
    found = rows(json.dumps(options))
    away = np.array([to_camera(TANK, row.target, row) for row in found])
    distance = np.linalg.norm(away, axis=1)
    fov = np.array([row.fov_x_deg for row in found])
    box = np.array([row.target.bbox for row in found])
    full = np.array([Intrinsics(1920, 1080, math.radians(f)).target_distance(TANK.size_xyz.min(), 1.0) for f in fov])
    axes = np.array([row.world_from_camera[:3, :3] for row in found])
    return {
        "distance": distance / full,
        "fraction": FACTOR * full / distance,
        "azimuth": np.degrees(np.arctan2(away[:, 1], away[:, 0])),
        "elevation": np.degrees(np.arcsin(away[:, 2] / distance)),
        "height": away[:, 2] / distance,
        "fov": fov,
        "x": box[:, 0] / (1920 - box[:, 2]),
        "y": box[:, 1] / (1080 - box[:, 3]),
        # The right axis of a camera rolled by r is below the horizon by sin(r) times the cosine of its elevation.
        "roll": np.degrees(np.arcsin(-axes[:, 2, 0] / np.hypot(*axes[:, :2, 2].T))),
    }


UNIFORM = {
    **{"azimuth": (-180.0, 180.0), "elevation": (10.0, 60.0), "fov": (40.0, 60.0)},
    **{"distance": (1.0 / FRACTION, 4.0 / FRACTION), "x": (0.0, 1.0), "y": (0.0, 1.0)},  # equation 6 times the factor
}
SPHERE = {"elevation_sampling": "sphere", "elevation_deg": [10, 85]}


@pytest.mark.parametrize(
    ("options", "key", "low", "high"),
    [
        *((FOUR, key, *bounds) for key, bounds in UNIFORM.items()),
        ({"target_fraction": [0.05, 0.3]}, "fraction", 0.05, 0.3),
        (SPHERE, "height", *np.sin(np.radians([10.0, 85.0]))),
        ({"roll_deg": [-20, 10], "elevation_deg": [5, 30]}, "roll", -20.0, 10.0),
    ],
)
def test_draws_are_uniform(options, key, low, high):
    share = (drawn(options)[key] - low) / (high - low)
    assert -1e-9 <= share.min() <= share.max() <= 1 + 1e-9
    assert stats.kstest(share, "uniform").pvalue > 1e-3


def test_elevations_on_the_sphere_are_not_uniform_in_angle():
    assert stats.kstest((drawn(SPHERE)["elevation"] - 10.0) / 75.0, "uniform").pvalue < 1e-3


@pytest.mark.parametrize("framing", [0.0, 0.4])
def test_framing_keeps_the_target_near_the_center(framing):
    found = drawn({"framing": framing})
    for key in ("x", "y"):
        # A thousandth of a pixel, where at least 300 pixels are free.
        assert 0.95 * framing / 2 <= np.abs(found[key] - 0.5).max() <= framing / 2 + 4e-6


def test_draws_are_independent():
    found = drawn(FOUR)
    columns = [found[key] for key in UNIFORM]
    # Also of the previous image.
    pairs = [*itertools.combinations(columns, 2), *((column[:-1], column[1:]) for column in columns)]
    assert all(abs(np.corrcoef(*pair)[0, 1]) < 4.0 / math.sqrt(N) for pair in pairs)
