"""Cameras are drawn as configured: every direction, distance, and framing has its stated distribution.

On a bare plane nothing is rejected, so a plan has the drawn values. Seeds are fixed, so a failure is a change.
"""

import itertools
import math

import numpy as np
import pytest

from hulldown.camera.intrinsics import Intrinsics
from hulldown.tests.planning_assets import bare, plan, small_assets, small_config, to_camera

N = 600
ASSETS = small_assets(bare("bare"), vehicles=["t72"])
TANK = ASSETS.vehicles["t72"]
# Kolmogorov's D: a uniform sample exceeds it with probability 0.001; other distributions exceed it by far.
FAR = 1.95 / math.sqrt(N)
FRACTION, FACTOR = 0.15, 2.0


def drawn(**camera):
    """For each image: the camera's distance over S f / H, azimuth, elevation, field of view, place in the frame."""
    options = {
        "fov_x_deg": [40, 60], "target_fraction": FRACTION, "distance_factor": FACTOR, "elevation_deg": [10, 60],
        "visible_fraction": [0, 1], "min_box_px": 0, "visibility_rays": 1, "framing": 1.0, **camera,
    }  # fmt: skip
    config = small_config(budget={"images_per_class": N, "images_per_position": 3}, camera=options)
    rows = list(plan(config, ASSETS))
    assert all(row.rejected == {} for row in rows)
    away = np.array([to_camera(TANK, row.target, row) for row in rows])
    distance = np.linalg.norm(away, axis=1)
    fov = np.array([row.fov_x_deg for row in rows])
    box = np.array([row.target.bbox for row in rows])
    full = np.array([Intrinsics(1920, 1080, math.radians(f)).distance_for(TANK.size_xyz.min(), 1.0) for f in fov])
    return {
        "distance": distance / full,
        "azimuth": np.degrees(np.arctan2(away[:, 1], away[:, 0])),
        "elevation": np.degrees(np.arcsin(away[:, 2] / distance)),
        "fov": fov,
        "x": box[:, 0] / (1920 - box[:, 2]),
        "y": box[:, 1] / (1080 - box[:, 3]),
        "rows": rows,
    }


def off_uniform(values, low, high):
    """Largest distance between the empirical distribution and the uniform one on [low, high]."""
    at = np.sort((values - low) / (high - low))
    assert at[0] >= -1e-9
    assert at[-1] <= 1 + 1e-9
    steps = np.arange(len(at) + 1) / len(at)
    return max(np.abs(at - steps[1:]).max(), np.abs(at - steps[:-1]).max())


@pytest.fixture(scope="module")
def found():
    return drawn(distance_factor=[1.0, 4.0])


UNIFORM = {
    **{"azimuth": (-180.0, 180.0), "elevation": (10.0, 60.0), "fov": (40.0, 60.0)},
    **{"distance": (1.0 / FRACTION, 4.0 / FRACTION), "x": (0.0, 1.0), "y": (0.0, 1.0)},  # equation 6 times the factor
}


@pytest.mark.parametrize("key", UNIFORM)
def test_draws_are_uniform(found, key):
    assert off_uniform(found[key], *UNIFORM[key]) < FAR


def test_target_fractions_are_uniform():
    assert off_uniform(FACTOR / drawn(target_fraction=[0.05, 0.3])["distance"], 0.05, 0.3) < FAR


@pytest.mark.parametrize("framing", [0.0, 0.4])
def test_framing_keeps_the_target_near_the_center(framing):
    found = drawn(framing=framing)
    for key in ("x", "y"):
        spread = np.abs(found[key] - 0.5)
        # A thousandth of a pixel, where at least 300 pixels are free.
        assert spread.max() <= framing / 2 + 4e-6
        assert spread.max() >= 0.95 * framing / 2


def test_elevations_are_uniform_on_the_sphere_on_request():
    elevation = drawn(elevation_sampling="sphere", elevation_deg=[10, 85])["elevation"]
    low, high = (math.sin(math.radians(angle)) for angle in (10.0, 85.0))
    assert off_uniform(np.sin(np.radians(elevation)), low, high) < FAR
    assert off_uniform(elevation, 10.0, 85.0) > FAR


def test_draws_are_independent(found):
    columns = [found[key] for key in UNIFORM]
    for a, b in itertools.combinations(columns, 2):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4.0 / math.sqrt(N)
    for column in columns:
        # Also independent of the previous image.
        assert abs(np.corrcoef(column[:-1], column[1:])[0, 1]) < 4.0 / math.sqrt(N)


def test_cameras_are_rolled_as_configured():
    found = drawn(roll_deg=[-20, 10], elevation_deg=[5, 30])
    down = np.array([row.world_from_camera[2, 0] for row in found["rows"]])
    level = np.hypot(*np.array([row.world_from_camera[:2, 2] for row in found["rows"]]).T)
    # The right axis of a camera rolled by r is below the horizon by sin(r) times the cosine of its elevation.
    assert off_uniform(np.degrees(np.arcsin(-down / level)), -20, 10) <= FAR
