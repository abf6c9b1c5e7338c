"""Vehicles with turned parts keep clear of obstacles."""

import math

import numpy as np
import pytest

from hulldown.geometry.transforms import rigid
from hulldown.planning.search.instances import Instances
from hulldown.planning.search.placing import clear_of_obstacles
from hulldown.planning.search.stage import make_stage
from hulldown.tests.planning_assets import small_assets, small_config
from hulldown.tests.shapes import box, scenery_of

POST = box((-0.1, -0.1, 0.0), (0.1, 0.1, 6.0))


@pytest.fixture(scope="module")
def stage():
    """A post near a vehicle's position, within reach of its gun but not of its hull."""
    post = scenery_of("bare", obstacles=(POST,), which=(0,), poses=(rigid(np.eye(3), [100.0, 54.0, 0.0]),))
    return make_stage(small_config(), small_assets(post, vehicles=["t72"]))


def clear(stage, turret, clearance):
    """Return whether a vehicle whose turret turns about (100, 50) is clear of the post, 4 m north of that point."""
    pivot = stage.models["t72"].shape.part_pivot[1] * [1.0, 1.0, 0.0]
    pose = rigid(np.eye(3), [100.0, 50.0, 0.0] - pivot)
    instances = Instances.of(stage.fleet, ["t72"], pose[None], [{"turret": turret}])
    return clear_of_obstacles(stage.sites[0], instances, clearance).item()


@pytest.mark.parametrize("clearance", [0.0, 0.5, 1.0])
def test_clearance_is_kept_around_turned_parts(stage, clearance):
    # Turned so that the gun's side passes the post at twice the clearance, and at half of it.
    gun_half, post_half, away = 0.1, 0.1 * math.sqrt(2), 4.0
    for share, free in ((2.0, True), (0.5, False)):
        beside = gun_half + post_half + share * clearance + (0.1 if free else -0.15)
        assert clear(stage, math.pi / 2 - math.asin(beside / away), clearance) == free
