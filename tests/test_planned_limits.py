"""Small worlds in which a plan that ignores one of the limits would break it."""

from collections import Counter

import numpy as np
import pytest

from hulldown.annotate.masks import vehicle_mask
from hulldown.camera.target import PosedVehicle, VehicleTarget
from hulldown.geometry.transforms import apply
from hulldown.tests.planning_assets import bare, hills, plan, small_assets, small_config, vehicle

TANK = vehicle("t72")
ROCK = 1  # of the obstacle meshes, lower than the gun
EDGE = np.linspace(0.0, 1.0, 9)
# Points all over a vehicle's three boxes, at most an eighth of a side apart.
OVER_A_BOX = np.stack(np.meshgrid(EDGE, EDGE, EDGE), -1).reshape(-1, 3)


def planned(scenery, *, images=20, **sections):
    config = small_config(budget={"images_per_class": images, "images_per_position": 2}, **sections)
    rows = list(plan(config, small_assets(scenery, vehicles=["t72"])))
    return rows, sum((Counter(row.rejected) for row in rows), Counter())


@pytest.mark.parametrize(("low", "high", "images"), [(0.97, 1.0, 12), (0.6, 0.9, 4)])
def test_visible_fractions_in_a_wood(low, high, images):
    wood = hills("wood", height=0.5, size=120.0, trees=250)
    rows, rejected = planned(wood, images=images, camera={"visible_fraction": [low, high], "max_tries": 300})
    assert all(low <= row.target.visible_fraction <= high for row in rows)
    assert rejected["hidden"] > 0
    assert bool(rejected["exposed"]) == (high < 1.0)


@pytest.mark.parametrize("clearance", [0.0, 3.0])
def test_vehicles_keep_their_clearance_from_obstacles(clearance):
    # Boxes of parts grow to the sides and upwards, so the clearance holds beside a level part and above.
    wood = hills("wood", height=0.0, size=80.0, trees=90)
    rows, rejected = planned(wood, images=40, placement={"obstacle_clearance": clearance, "articulate": not clearance})
    assert rejected["obstacle"] > 10
    parts = [TANK.mesh.vertices[TANK.vertex_part == k] for k in range(3)]
    points = [low + OVER_A_BOX * (high - low) for low, high in ((p.min(axis=0), p.max(axis=0)) for p in parts)]
    boxes = [
        apply(pose, wood.obstacle_meshes[k].vertices)[[0, -1]]
        for pose, k in zip(wood.world_from_instance, wood.instance_mesh.tolist(), strict=True)
        if not (clearance and k == ROCK)
    ]
    nearest = []
    for row in rows:
        poses = TANK.vehicle_from_parts(row.target.articulation)
        world = apply(row.target.world_from_vehicle, np.concatenate([apply(poses[k], points[k]) for k in range(3)]))
        away = [np.maximum(np.maximum(low - world, world - high), 0.0) for low, high in boxes]
        nearest.append(min(np.linalg.norm(d, axis=1).min() for d in away))
    assert min(nearest) >= clearance
    if not clearance:
        # Tilted boxes may be nearer without overlapping: no point is inside an obstacle.
        assert 0.0 < min(nearest) < 3.0


def test_a_target_smaller_than_a_pixel_covers_the_center_of_one():
    """Its mask would be empty."""
    rows, rejected = planned(
        bare("bare"), images=40, render={"width": 64, "height": 48}, placement={"articulate": False},
        camera={"size_measure": "height", "target_fraction": [0.01, 0.03], "min_box_px": 0.1, "max_tries": 300},
    )  # fmt: skip
    assert rejected["hidden"] > 5
    target = VehicleTarget(TANK)
    for row in rows:
        assert row.target.bbox[3] < 2
        assert vehicle_mask(PosedVehicle(target, row.target.world_from_vehicle[None], {}), row.camera).any()
