"""Vehicles with turned parts, and clearance from obstacles."""

import math

import numpy as np
import pytest

from hulldown.assets.library import Assets
from hulldown.geometry.transforms import rigid, rotation_z
from hulldown.planning.search.instances import Instances
from hulldown.planning.search.placing import clear_of_obstacles
from hulldown.planning.search.stage import make_stage
from hulldown.tests.planning_assets import CLASSES, small_config, vehicle
from hulldown.tests.shapes import box, scenery_of

POST = box((-0.1, -0.1, 0.0), (0.1, 0.1, 6.0))
QUARTER = math.pi / 2


@pytest.fixture(scope="module")
def stage():
    """A post near a vehicle's position, within reach of its gun but not of its hull."""
    post = scenery_of("bare", obstacles=(POST,), which=(0,), poses=(rigid(np.eye(3), [100.0, 54.0, 0.0]),))
    vehicles = {name: vehicle(name) for name in CLASSES}
    assets = Assets(vehicles, CLASSES, {"bare": post}, ("noon",))
    config = small_config(assets={"sceneries": [{"path": "bare.blend"}]})
    return make_stage(config, assets)


def clear(stage, *articulation, yaw=0.0, clearance=0.0):
    """Whether vehicles whose turrets turn about (100, 50) are clear of the post, 4 m north of that point."""
    pivot = stage.models["t72"].shape.part_pivot[1] * [1.0, 1.0, 0.0]
    turn = rotation_z(yaw)
    poses = np.tile(rigid(turn, [100.0, 50.0, 0.0] - turn @ pivot), (len(articulation), 1, 1))
    instances = Instances.of(stage.fleet, ["t72"] * len(articulation), poses, articulation)
    return clear_of_obstacles(stage.sites[0], instances, clearance).tolist()


def test_a_turned_gun_is_checked_like_a_hull(stage):
    ahead, left, right = {}, {"turret": QUARTER}, {"turret": -QUARTER}
    assert clear(stage, ahead, left, right) == [True, False, True]
    # The same with the vehicle turned and the turret turned back.
    assert clear(stage, ahead, right, {"turret": math.pi}, yaw=QUARTER) == [False, True, True]


@pytest.mark.parametrize("clearance", [0.0, 0.5, 1.0])
def test_clearance_is_kept_around_turned_parts(stage, clearance):
    # Turned so that the gun's side passes the post at twice the clearance, and at half of it.
    gun_half, post_half, away = 0.1, 0.1 * math.sqrt(2), 4.0
    for share, free in ((2.0, True), (0.5, False)):
        beside = gun_half + post_half + share * clearance + (0.1 if free else -0.15)
        turn = QUARTER - math.asin(beside / away)
        assert clear(stage, {"turret": turn}, clearance=clearance) == [free]
