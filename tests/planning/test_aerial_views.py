"""Views from the air: the ranges of `init --aerial`, and straight down, where a camera has no azimuth."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from hulldown import cli
from hulldown.camera.shell import camera_pose
from hulldown.dataset.row_records import planned_label_records
from hulldown.plan.config.schema import Config
from hulldown.planning.check import check_plan
from hulldown.planning.write import write_plan
from hulldown.tests.builders.planning_assets import small_assets, small_config, to_camera

ASSETS = small_assets()


def planned(folder, **camera):
    """A plan with the cameras of `init --aerial`, and these."""
    assert cli.main(["init", str(folder), "--bare", "--aerial"]) == 0
    written = Config.read(folder / "hulldown.toml").camera.model_dump()
    config = small_config(camera={**written, **camera}, budget={"images_per_class": 6})
    return write_plan(config, ASSETS, folder / "plan.jsonl")


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    return planned(tmp_path_factory.mktemp("aerial"))


def test_aerial_views_are_within_their_ranges(plan):
    away = np.array([to_camera(ASSETS.vehicles[row.target.vehicle], row.target, row) for row in plan])
    distance = np.linalg.norm(away, axis=1)
    assert (np.abs(distance - 165.0) < 135.0 + 1e-6).all()
    assert (np.degrees(np.arcsin(away[:, 2] / distance)) > 45.0 - 1e-6).all()
    rolls = [math.atan2(-row.world_from_camera[2, 0], -row.world_from_camera[2, 1]) for row in plan]
    assert np.ptp(rolls) > 2.0
    assert check_plan(plan, ASSETS) == []


def test_straight_down_can_be_planned_and_has_a_defined_azimuth(tmp_path):
    plan = planned(tmp_path, elevation_deg=[90, 90])
    for row in plan:
        assert (row.world_from_camera[:3, :3] @ [0, 0, 1])[2] < -0.8  # framed, so not exactly straight down
        assert row.target.visible_fraction > 0.3
    assert check_plan(plan, ASSETS) == []


@pytest.mark.parametrize("azimuth", [0.0, 1.0, -2.5])
def test_the_azimuth_straight_down_is_the_limit_from_nearby(plan, azimuth):
    row = plan[0]
    target, away = replace(row.target, world_from_vehicle=np.eye(4), label="full"), []
    middle = (np.array(target.bounds.low) + np.array(target.bounds.high)) / 2
    for elevation in (math.pi / 2, math.pi / 2 - 1e-3):
        pose = camera_pose(middle, 100.0, azimuth, elevation)
        pose[:3, 3] = np.round(pose[:3, 3], 9)  # rounded as in plans, which decides the direction
        seen = replace(row, world_from_camera=pose, planned=[target], background=False)
        away.append(planned_label_records(seen)[0]["azimuth_seen"])
    assert away == pytest.approx([azimuth, azimuth], abs=1e-5)
