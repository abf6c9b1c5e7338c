"""Plans of random configs: every limit holds when recomputed independently, and the cut of work doesn't matter."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st

from hulldown.annotate.boxes import surface_box
from hulldown.annotate.masks import decode_mask
from hulldown.annotate.records import Image, Label
from hulldown.base.errors import ConfigError
from hulldown.camera.cameras import Cameras
from hulldown.camera.intrinsics import Intrinsics
from hulldown.dataset.attributes import label_attribute_values
from hulldown.dataset.row_records import Segmenter, planned_label_records, recorded_image_fields
from hulldown.geometry.transforms import transform_points
from hulldown.placement.terrain import Terrain
from hulldown.plan.config.asset_sections import OWN_COLOR
from hulldown.plan.summary import summarize_plan
from hulldown.planning.check import relabel_row, site_and_posed_vehicles
from hulldown.planning.planner import Planner
from hulldown.scene.ray_caster import RayCaster
from hulldown.tests.builders.planning_assets import (
    DISTRACTOR_ENTRIES,
    VEHICLE_ENTRIES,
    filled_share,
    small_assets,
    small_config,
    to_camera,
)
from hulldown.tests.builders.shapes import vertices_at
from hulldown.weather.kinds import WEATHER_KINDS

# Rounding of rows: see plan/row.py.
ROUNDED, ROTATION, PIXELS = 1e-9, 1e-12, 1e-6

ASSETS = small_assets(distractors=True)
SHAPES = {**ASSETS.vehicles, **ASSETS.distractors}
CASTERS = {name: RayCaster(scenery.ground) for name, scenery in ASSETS.sceneries.items() if scenery.ground}
TERRAINS = {name: Terrain(scenery.ground) for name, scenery in ASSETS.sceneries.items() if scenery.ground}
# Plans take longer than Hypothesis expects.
FEW = settings(max_examples=max(4, settings.default.max_examples // 8), suppress_health_check=list(HealthCheck))


def interval(low, high, least=0.0):
    """[a, b] within bounds, with a minimum width."""
    return st.tuples(st.floats(low, high - least), st.floats(0.0, 1.0)).map(
        lambda p: [p[0], p[0] + least + p[1] * (high - p[0] - least)]
    )


@st.composite
def configs(draw):
    colors = draw(st.sampled_from([["#94835e"], ["own", "#4b5320"]]))
    paints = [{"materials": ["camo*"], "colors": colors}, {"materials": ["*"], "colors": ["own"]}]
    entries = [[{**entry, "paint": paints} for entry in listed] for listed in (VEHICLE_ENTRIES, DISTRACTOR_ENTRIES)]
    return small_config(
        seed=draw(st.integers(0, 2**63 - 1)),
        assets={"vehicles": entries[0], "distractors": draw(st.sampled_from([[], entries[1]]))},
        budget={
            "images_per_class": draw(st.integers(2, 5)),
            "images_per_position": draw(st.integers(1, 3)),
            "background_share": draw(st.sampled_from([0.0, 0.4])),
            "background_distractors": draw(st.floats(0.0, 1.0)),
        },
        annotate={"below": draw(st.sampled_from(["ignored", "left_out"]))},
        placement={
            "margin": draw(st.floats(0.3, 1.0)),
            "max_slope_deg": draw(st.floats(8.0, 40.0)),
            "rule": draw(st.sampled_from(["averaged", "support"])),
            "max_gap": draw(st.floats(0.8, 3.0)),
            "max_penetration": draw(st.floats(0.1, 0.4)),
            "obstacle_clearance": draw(st.floats(0.0, 2.0)),
            "vehicles_per_image": draw(st.sampled_from([[1, 1], [1, 2], [2, 2]])),
            "companion_distance": [10, 40],
            "articulate": draw(st.booleans()),
            "max_tries": 400,
        },
        camera={
            "fov_x_deg": draw(interval(5.0, 100.0)),
            "size_measure": draw(st.sampled_from(["paper", "height", "width", "diagonal", "area"])),
            "target_fraction": draw(interval(0.05, 0.4)),
            "distance_factor": draw(interval(0.8, 3.0)),
            "elevation_deg": draw(interval(-2.0, 60.0, 8.0)),
            "elevation_sampling": draw(st.sampled_from(["angle", "sphere"])),
            "framing": draw(st.floats(0.0, 1.0)),
            "ground_clearance": draw(st.floats(0.0, 2.0)),
            "visible_fraction": [draw(st.floats(0.0, 0.9)), 1.0],
            "min_box_px": draw(st.floats(1.0, 40.0)),
            "truncated_fraction": draw(st.sampled_from([[0.0, 0.0], [0.0, 0.4]])),
            "visibility_rays": draw(st.integers(16, 64)),
            "distance_m": [3.0, 400.0],
            "max_tries": 12,
        },
        light={"yaw_deg": draw(interval(-360.0, 360.0)), "strength": draw(interval(0.0, 5.0))},
        weather={
            "fog": draw(st.floats(0.0, 0.4)),
            "rain": draw(st.floats(0.0, 0.2)),
            "snow": draw(st.floats(0.0, 0.2)),
            "dust": draw(st.floats(0.0, 0.2)),
            "visibility_m": draw(interval(10.0, 5000.0)),
            "min_contrast": draw(st.floats(0.0, 0.3)),
        },
        render={"width": draw(st.integers(64, 2000)), "height": draw(st.integers(64, 2000))},
    )


def planned(config):
    try:
        planner = Planner(config, ASSETS)
        return planner, planner.rows(0, planner.budget.n_planned_positions)
    except ConfigError:
        # Some configs can't be met; tests/planning/test_planner.py checks their errors.
        reject()


@pytest.fixture(scope="module", autouse=True)
def give_up_soon():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hulldown.planning.search.positions.MAX_PLACES_WITHOUT_CAMERA", 4)
        patch.setattr("hulldown.planning.search.positions.MAX_PLACES_WITHOUT_ROOM", 4)
        yield


@FEW
@given(configs())
def test_every_row_keeps_every_limit(config):
    planner, rows = planned(config)
    budget_is_met(rows, planner.budget)
    for row in rows:
        for k, vehicle in enumerate(row.planned):
            stands_within_limits(row, vehicle, config, target=k == 0)
            painted_within_limits(vehicle, config)
        camera_within_limits(row, config)
        light_within_limits(row, config)
        labels_are_what_is_seen(row, config)
        labels_follow_from_the_poses(row, relabel_row(row, *site_and_posed_vehicles(row, planner.stage), planner.stage))
        guests_keep_their_distance(row, config)
    shown_angles_are_the_configured_ones(rows, config)


def shown_angles_are_the_configured_ones(rows, config):
    """Summary and labels measure distance and elevation as the config does, from the center of the target's box."""
    summary, limits = summarize_plan(rows).histograms, config.camera
    of_image = {"id": 1, "image_id": 1, "category_id": 1, "file_name": "1.png"}
    shown = [row for row in rows if not row.background and row.target.label != "none"]
    labels = [Label.from_record(planned_label_records(row)[0] | of_image, {}) for row in shown]
    images = [Image.from_record(recorded_image_fields(row) | of_image, ()) for row in shown]
    numbers = label_attribute_values(labels, images, np.arange(len(labels)))
    for low, high, shown in (
        (*limits.elevation_deg, (summary["elevation_deg"].values, numbers["elevation"])),
        (*limits.distance_m, (summary["distance_m"].values, numbers["distance"])),
    ):
        for values in shown:
            assert ((values >= low - 1e-5) & (values <= high + 1e-5)).all()


def budget_is_met(rows, budget):
    """Every vehicle has exactly its images, in addition to backgrounds."""
    images = Counter(row.target.vehicle for row in rows if not row.background)
    assert [images[name] for name in budget.vehicles] == budget.images.tolist()
    assert sum(row.background for row in rows) == budget.n_images - budget.images.sum()


def labels_follow_from_the_poses(row, again):
    """Labels of each single row equal those planned in batches."""
    for one, other in zip(row.planned, again.planned, strict=True):
        assert (one.label, one.bounds) == (other.label, other.bounds)
        for key in ("visible_fraction", "truncated_fraction", "air_contrast", "slope_deg", "gap", "penetration"):
            assert getattr(one, key) == pytest.approx(getattr(other, key), abs=2 * ROUNDED), key


def guests_keep_their_distance(row, config):
    """Companions and distractors have the drawn distance from the target, and no vertex is in another vehicle's box."""
    limits = config.placement
    for kind, (low, high) in (("companions", limits.companion_distance), ("distractors", limits.distractor_distance)):
        for vehicle in getattr(row, kind):
            away = math.dist(vehicle.world_from_vehicle[:2, 3], row.target.world_from_vehicle[:2, 3])
            assert low - 1e-6 <= away <= high + 1e-6
    for one in row.planned:
        for other in row.planned:
            if one is not other:
                points = transform_points(other.world_from_vehicle, vertices_at(SHAPES[other.vehicle], other.articulation))
                points = transform_points(np.linalg.inv(one.world_from_vehicle), points)
                hull = SHAPES[one.vehicle].mesh.vertices[:8]
                low, high = hull.min(axis=0), hull.max(axis=0)
                assert not ((points > low) & (points < high)).all(axis=1).any()


def labels_are_what_is_seen(row, config):
    """Every label has pixels, and all pixels of a class have a label, perhaps an ignored one.

    Visible masks are disjoint, and amodal ones contain them.
    """
    segmenter = Segmenter(SHAPES, ASSETS.sceneries)
    covered = np.zeros((row.height, row.width), dtype=int)
    for record in segmenter.label_records_with_masks(row):
        visible, whole = (decode_mask(record[key], row.width, row.height) for key in ("segmentation", "segmentation_amodal"))
        assert not (visible & ~whole).any()
        covered += visible
    assert covered.max() <= 1
    for vehicle in (vehicle for vehicle in row.vehicles if vehicle.bbox is not None):
        mask, label = segmenter.mask(row, vehicle), vehicle.label
        assert mask.any() or label == "none"
        assert vehicle.category is not None or label == "none"
        if mask.any() and vehicle.category is not None:
            assert label != "none" or config.annotate.below == "left_out"
    assert not (row.background and row.labeled)
    # COCO's term for labels that count neither as missed nor as false positives.
    crowds = [record["iscrowd"] for record in planned_label_records(row)]
    assert crowds == [{"full": 0, "ignored": 1}[vehicle.label] for vehicle in row.labeled]


def stands_within_limits(row, vehicle, config, *, target):
    limits, scenery = config.placement, ASSETS.sceneries[row.scenery]
    shape, pose = SHAPES[vehicle.vehicle], np.array(vehicle.world_from_vehicle)
    assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=4 * ROTATION)
    assert math.degrees(math.acos(min(pose[2, 2], 1.0))) <= limits.max_slope_deg + 1e-6
    assert vehicle.slope_deg == pytest.approx(math.degrees(math.acos(min(pose[2, 2], 1.0))), abs=1e-5)
    names = shape.part_names[1:]
    assert set(vehicle.articulation) == (set(names) if limits.articulate else set())
    for name, (low, high) in zip(names, shape.part_limits[1:].tolist(), strict=True):
        assert low - ROTATION <= vehicle.articulation.get(name, 0.0) <= high + ROTATION
    if scenery.ground is None:
        assert pose[2, 3] == pytest.approx(-scenery.origin[2], abs=ROUNDED)
        return
    low, high = scenery.ground.bounds[:, :2]
    if target:
        assert (np.abs(pose[:2, 3] - (low + high) / 2) <= limits.margin * (high - low) / 2 + 1e-9).all()
    # The hulls of these vehicles touch the ground; their boxes end at their vertices.
    under = shape.mesh.vertices[:8, :2]
    (x0, y0), (x1, y1) = under.min(axis=0), under.max(axis=0)
    grid = [[x, y, 0.0] for x in np.linspace(x0, x1, 9) for y in np.linspace(y0, y1, 9)]
    points = transform_points(pose, grid)
    # Cast by Embree directly, independently of placement.
    above_them = points + np.array([0.0, 0.0, 100.0])
    hits = CASTERS[scenery.name].cast(above_them, np.tile([0.0, 0.0, -1.0], (len(points), 1)))
    above = (hits.distance - 100.0)[hits.hit]
    assert above.max() <= limits.max_gap + 1e-3
    assert -above.min() <= limits.max_penetration + 1e-3
    assert vehicle.gap == pytest.approx(max(above.max(), 0.0), abs=1e-3)
    world = transform_points(pose, vertices_at(shape, vehicle.articulation))
    for pose_k, mesh_k in zip(scenery.world_from_instance, scenery.instance_mesh, strict=True):
        obstacle = transform_points(pose_k, scenery.obstacle_meshes[mesh_k].vertices)
        # Necessary, not sufficient: no vertex of the vehicle may be inside an obstacle's (axis-aligned) box.
        inside = ((world > obstacle.min(axis=0)) & (world < obstacle.max(axis=0))).all(axis=1)
        assert not inside.any()


def within(value, bounds):
    return bounds[0] - ROUNDED <= value <= bounds[1] + ROUNDED


def camera_within_limits(row, config):
    limits = config.camera
    shape, pose = SHAPES[row.target.vehicle], np.array(row.target.world_from_vehicle)
    camera = np.array(row.world_from_camera)
    assert within(row.fov_x_deg, limits.fov_x_deg)
    away = to_camera(shape, row.target, row)
    distance = np.linalg.norm(away)
    intrinsics = Intrinsics(row.width, row.height, math.radians(row.fov_x_deg))
    if limits.size_measure == "paper":
        near, far = (float(intrinsics.target_distance(shape.size_xyz.min(), t)) for t in limits.target_fraction[::-1])
        assert near * limits.distance_factor[0] * (1 - 1e-9) <= distance <= far * limits.distance_factor[1] * (1 + 1e-9)
    else:
        low, high = limits.target_fraction
        size = min(row.target.bbox_amodal[2:])
        share = filled_share(row.target.bbox_amodal[2:], row, limits.size_measure)
        assert low * (1 - 4 * PIXELS / size) <= share <= high * (1 + 4 * PIXELS / size)
    assert limits.distance_m[0] - 1e-6 <= distance <= limits.distance_m[1] + 1e-6
    elevation = math.degrees(math.asin(away[2] / distance))
    assert limits.elevation_deg[0] - 1e-5 <= elevation <= limits.elevation_deg[1] + 1e-5
    scenery = ASSETS.sceneries[row.scenery]
    ground = TERRAINS[scenery.name].top_hits(camera[None, :2, 3]).z[0] if scenery.ground else 0.0
    assert camera[2, 3] - ground >= limits.ground_clearance - 1e-9
    vertices = transform_points(pose, vertices_at(shape, row.target.articulation))
    found = surface_box(vertices, shape.mesh.faces, Cameras(intrinsics, camera))
    amodal = surface_box(vertices, shape.mesh.faces, Cameras(intrinsics, camera), frame=False)
    assert row.target.bbox == pytest.approx(found, abs=1e-6)
    assert row.target.bbox_amodal == pytest.approx(amodal, abs=1e-6)
    assert within(row.target.truncated_fraction, limits.truncated_fraction)
    assert row.target.truncated_fraction == pytest.approx(1 - np.prod(found[2:]) / np.prod(amodal[2:]), abs=2 * ROUNDED)
    assert within(row.target.visible_fraction, limits.visible_fraction)
    assert min(row.target.bbox[2:]) >= limits.min_box_px - PIXELS


def painted_within_limits(vehicle, config):
    for coat, entry in zip(vehicle.paint, config.vehicle_paint(vehicle.vehicle), strict=True):
        assert coat.materials == list(entry.materials)
        assert (coat.color or OWN_COLOR) in entry.colors


def light_within_limits(row, config):
    assert within(row.hdri_yaw_deg, config.light.yaw_deg)
    assert within(row.strength, config.light.strength)
    kind = "clear" if row.weather is None else row.weather.kind
    if row.weather is not None:
        assert getattr(config.weather, kind) > 0.0
        for key, value in (
            (WEATHER_KINDS[kind].visibility, row.weather.visibility_m),
            (WEATHER_KINDS[kind].rate, row.weather.rain_mm_h),
        ):
            assert not key or within(value, getattr(config.weather, key))
    assert row.target.air_contrast >= config.weather.min_contrast - ROUNDED
    for vehicle in row.planned:
        away = np.linalg.norm(to_camera(SHAPES[vehicle.vehicle], vehicle, row))
        left = 1.0 if row.weather is None else 0.02 ** (away / row.weather.visibility_m)
        assert vehicle.air_contrast == pytest.approx(left, abs=2 * ROUNDED)
    assert 0 <= row.sample_seed < 2**31
    assert (row.width, row.height) == (config.render.width, config.render.height)


def outcome(config, cuts, order=None):
    """Lines or the error of positions planned in blocks that begin at these, in any order."""
    try:
        planner = Planner(config, ASSETS)
        blocks = list(zip([0, *cuts], [*cuts, planner.budget.n_planned_positions], strict=True))
        lines = [planner.lines(*blocks[i])[0] for i in order or range(len(blocks))]
    except ConfigError as error:
        return str(error)
    return sorted(line for block in lines for line in block.splitlines())


@FEW
@given(configs(), st.integers(1, 20) | st.just(400), st.sampled_from([16, 64]), st.data())
def test_lines_and_failures_never_depend_on_how_the_work_is_cut(config, tries, candidates, data):
    placement = config.placement.model_copy(update={"max_tries": tries})
    config = config.model_copy(update={"placement": placement})
    try:
        n = Planner(config, ASSETS).budget.n_planned_positions
    except ConfigError:
        reject()
    cuts = sorted(data.draw(st.sets(st.integers(1, n - 1), max_size=4))) if n > 1 else []
    whole = outcome(config, [])
    # The first of several failures is reported, which depends on the order.
    order = data.draw(st.permutations(range(len(cuts) + 1))) if isinstance(whole, list) else None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hulldown.planning.search.positions.MAX_BATCH_PLACES", candidates)
        assert outcome(config, cuts, order) == whole
