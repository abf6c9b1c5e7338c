"""Small worlds in which a plan that ignores a limit or a requested size would break it, and the count of tries."""

from collections import Counter
from functools import cache

import numpy as np
import pytest

from hulldown.annotate.boxes import surface_box
from hulldown.annotate.silhouettes import whole_and_visible_masks
from hulldown.base.errors import ConfigError
from hulldown.geometry.transforms import transform_points
from hulldown.plan.rejection import first_accepted_and_counts
from hulldown.plan.row import encode_rows
from hulldown.planning.planner import Planner
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.tests.builders.planning_assets import bare, filled_share, hills, plan, small_assets, small_config, vehicle
from hulldown.tests.builders.shapes import vertices_at

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
        transform_points(pose, wood.obstacle_meshes[k].vertices)[[0, -1]]
        for pose, k in zip(wood.world_from_instance, wood.instance_mesh.tolist(), strict=True)
        if not (clearance and k == ROCK)
    ]
    nearest = []
    for row in rows:
        poses = TANK.vehicle_from_parts(row.target.articulation)
        world = transform_points(
            row.target.world_from_vehicle, np.concatenate([transform_points(poses[k], points[k]) for k in range(3)])
        )
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
    target = VehicleCaster(TANK)
    for row in rows:
        assert row.target.bbox[3] < 2
        assert whole_and_visible_masks(PosedVehicle(target, row.target.world_from_vehicle[None], {}), row.camera)[1].any()


def sized(**camera):
    return list(plan(small_config(camera=camera, budget={"images_per_class": 6}), small_assets(vehicles=["t72"])))


def amodal_share(row, measure):
    """Share of the image by the exact rule, from the row's poses alone."""
    vertices = transform_points(row.target.world_from_vehicle, vertices_at(TANK, row.target.articulation))
    return filled_share(surface_box(vertices, TANK.mesh.faces, row.camera, frame=False)[2:], row, measure)


@pytest.mark.parametrize("truncated", [[0.0, 0.0], [0.1, 0.4]], ids=["whole", "cut"])
@pytest.mark.parametrize("measure", ["height", "width", "diagonal", "area"])
def test_the_box_has_the_requested_size(measure, truncated):
    for row in sized(size_measure=measure, target_fraction=0.15, framing=1.0, truncated_fraction=truncated):
        assert amodal_share(row, measure) == pytest.approx(0.15, rel=1e-9)  # as plans promise
        assert truncated[0] <= row.target.truncated_fraction <= truncated[1]


def test_sizes_cover_their_range_and_the_distance_factor_is_unused():
    options = {"size_measure": "area", "target_fraction": [0.0005, 0.0044]}
    rows = sized(**options, distance_factor=1.0)
    shares = [amodal_share(row, "area") for row in rows]
    assert 0.0005 <= min(shares) < 0.0015 < 0.003 < max(shares) <= 0.0044
    assert encode_rows(sized(**options, distance_factor=4.0)) == encode_rows(rows)


def test_a_size_that_no_distance_gives_is_counted():
    # A box ten times as high as the image needs a camera inside the vehicle or too close to it.
    rows = sized(
        size_measure="height", target_fraction=[0.3, 10.0], truncated_fraction=[0.0, 1.0], distance_m=[0.0, 5000.0],
        obstacle_clearance=0.0, fov_x_deg=120.0, max_tries=500,
    )  # fmt: skip
    assert sum(row.rejected.get("size", 0) for row in rows) > 0


@cache
def planner_of(max_tries, *, slope_deg=2.5, blind_below_px=None):
    """A world with few level places, all of them visible."""
    camera = {"min_box_px": blind_below_px, "max_tries": 1} if blind_below_px else {}
    config = small_config(
        budget={"images_per_class": 8, "images_per_position": 1},
        camera={"visibility_rays": 4, **camera},
        placement={"max_slope_deg": slope_deg, "max_tries": max_tries},
    )
    return Planner(config, small_assets(hills("hills", cells=20, trees=3)))


@pytest.mark.parametrize("limit", [1, 2, 3, 5])
def test_no_position_is_tried_more_often_than_allowed(limit):
    # max_tries = 2 gave rows with 3 tries.
    planner = planner_of(limit)
    for row in planner_of(10_000).rows(0, 8):
        position = row.position
        if row.target.tries <= limit:
            assert encode_rows(planner.rows(position, position + 1)) == encode_rows([row])
        else:
            with pytest.raises(ConfigError, match=f"of {limit} tries"):
                planner.rows(position, position + 1)


def test_only_tries_within_a_positions_limit_are_taken():
    rejection = np.array([[1, 0, 0], [2, 2, 0], [0, 1, 1]], dtype=np.uint8)
    taken, chosen, counts = first_accepted_and_counts(rejection, np.array([3, 2, 1]))
    assert taken.tolist() == [True, False, True]
    assert chosen.tolist() == [1, 6]
    assert counts.sum(axis=1).tolist() == [1, 2, 0]


def test_places_without_a_view_count_as_tries():
    # A position that no camera sees is moved, and its tries count on.
    with pytest.raises(ConfigError, match=r"finds no place to stand: of 6 tries .*could not be seen by any camera"):
        planner_of(6, slope_deg=40.0, blind_below_px=700).rows(0, 1)
    seldom = planner_of(30, slope_deg=40.0, blind_below_px=100)
    assert all(row.target.tries <= 30 for row in seldom.rows(0, 8))
