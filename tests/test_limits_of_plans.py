"""The table of limits: every key of the config has its place in it, and what a header's change breaks is found."""

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from assets.library import Assets
from geometry.errors import ConfigError
from geometry.meshes import Mesh
from planning.check import check_plan
from planning.limits import LIMITS
from planning.not_recomputed import NOT_RECOMPUTED
from planning.plan_file import read_plan
from planning.preview import Artist
from planning.schema import Config, Section
from planning.write import write_plan
from tests.planning_assets import (
    DISTRACTOR_ENTRIES,
    VEHICLE_ENTRIES,
    bare,
    hills,
    sheet,
    small_assets,
    small_config,
    with_water,
)

PAINT = {"colours": ["own", "#4b5320", "#94835e"], "hue_deg": [-9, 9], "saturation": [0.5, 1], "value": [0.5, 2]}
DOCS = Path(__file__).parents[1] / "docs" / "limits.md"


def sections_in(annotation):
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield annotation
    for inner in get_args(annotation):
        yield from sections_in(inner)


def keys_of(section=Config, prefix=""):
    """Every key of the config, as "section.key"."""
    for name, field in section.model_fields.items():
        inner = list(sections_in(field.annotation))
        # An HDRI's name is what `light.hdris` chooses by.
        if not inner or name == "hdris":
            yield prefix + name
        for one in inner:
            yield from (key for key in keys_of(one, f"{prefix}{name}.") if key != "light.hdris.name")


def test_every_key_is_checked_or_says_why_not():
    checked = {key for limit in LIMITS for key in limit.keys}
    assert checked | set(NOT_RECOMPUTED) == set(keys_of())
    assert not checked & set(NOT_RECOMPUTED)
    assert all(NOT_RECOMPUTED.values())


def holed(name):
    """Hills that lack a twelfth of their triangles."""
    scenery = hills(name, size=120.0, cells=40, trees=60)
    kept = np.random.default_rng(3).random(len(scenery.ground.faces)) > 1 / 12
    ground = Mesh(scenery.ground.vertices, scenery.ground.faces[kept], "ground")
    return type(scenery)(**{
        **{f: getattr(scenery, f) for f in scenery.__dataclass_fields__},
        "ground": ground, "face_ground": scenery.face_ground[kept],
    })  # fmt: skip


@pytest.fixture(scope="module")
def assets():
    base = small_assets(distractors=True)
    ford = with_water(holed("hills"), sheet((-60, -60), (60, 60), 0.0))
    sceneries = {"hills": ford, "bare": bare("bare")}
    return Assets(base.vehicles, base.categories, sceneries, ("noon", "dusk"), distractors=base.distractors)


@pytest.fixture(scope="module")
def made(assets, tmp_path_factory):
    config = small_config(
        seed=3,
        assets={
            "vehicles": [{**entry, "paint": PAINT} for entry in VEHICLE_ENTRIES],
            "distractors": [{**entry, "paint": PAINT} for entry in DISTRACTOR_ENTRIES],
        },
        budget={"images_per_class": 10, "images_per_position": 2, "background_share": 0.2},
        placement={"min_valid_share": 0.4, "vehicles_per_image": 2, "companion_distance": [9, 30], "fording_depth": 9},
        camera={"visible_fraction": [0.2, 1.0], "distance_m": [2, 60]},
        weather={"fog": 0.2, "rain": 0.2, "snow": 0.2, "dust": 0.2},
    )
    return write_plan(config, assets, tmp_path_factory.mktemp("made") / "plan.jsonl")


def test_the_plan_itself_breaks_nothing(made, assets):
    assert check_plan(made, assets) == []


CHANGES = [
    ("seed", 4, "sample_seed"),
    ("assets.sceneries.weight", 0.0, "scenery, which has no weight"),
    ("assets.vehicles.sceneries", ["bare"], "breaks scenery, which the vehicle is not for"),
    *(
        (f"assets.{kind}.paint.{key}", value, message)
        for kind, message in (("vehicles", "breaks paint, which is"), ("distractors", "].paint, which is not what was"))
        for key, value in (
            ("materials", ["hull"]),
            ("colours", ["#405060"]),
            ("hue_deg", [-3.0, 3.0]),
            ("saturation", [0.9, 1.0]),
            ("value", 1.0),
        )
    ),
    ("ground.fallback_z", 1.5, "world_from_vehicle, which is not where the vehicle comes to rest"),
    ("placement.margin", 0.2, "place"),
    ("placement.max_slope_deg", 1.0, "slope_deg is"),
    ("placement.max_slope_deg", 1.0, "slope at the spot is"),
    ("placement.rule", "least_squares", "world_from_vehicle, which is not where"),
    ("placement.contact", "box", "world_from_vehicle, which is not where"),
    ("placement.footprint", 2, "world_from_vehicle, which is not where"),
    ("placement.min_valid_share", 1.0, "share of the footprint's rays"),
    ("placement.max_gap", 0.0, "gap is"),
    ("placement.max_penetration", 0.0, "penetration is"),
    ("placement.fording_depth", 0.1, "depth in water is"),
    ("placement.obstacle_clearance", 12.0, "placement.obstacle_clearance"),
    ("placement.vehicle_clearance", 20.0, "placement.vehicle_clearance"),
    ("placement.vehicles_per_image", [1, 1], "vehicles in the image is 2, allowed are 1 to 1"),
    ("placement.companion_distance", [9.0, 10.0], "distance from the target is"),
    ("placement.distractors_per_image", [1, 3], "distractors, which are not those that were drawn"),
    ("assets.distractors.weight", 0.01, "distractors, which are not those that were drawn"),
    ("assets.distractors.sceneries", ["bare"], "distractors, which are not those that were drawn"),
    ("placement.distractor_distance", [30.0, 32.0], "distance from what the camera is framed on is"),
    ("annotate.max_truncated_fraction", 1.0, "breaks companions[0].label"),
    ("annotate.below", "left_out", "breaks companions[0].label"),
    ("placement.articulate", False, "articulation"),
    ("placement.max_tries", 1, "tries is"),
    ("light.exposure", 4.0, "breaks exposure_ev, which is not what its light asks for"),
    ("light.exposure_error_ev", [-1.0, 0.0], "breaks exposure_ev, which is not what its light asks for"),
    ("light.white_balance_error_k", [-200.0, 200.0], "breaks white_balance_k, which is not what was drawn"),
    ("light.backdrop", "sky", "breaks horizon_deg, which is not the HDRI's"),
    ("camera.fov_x_deg", [40.0, 41.0], "fov_x_deg is"),
    ("camera.size_measure", "height", "share of the image that the box fills is"),
    ("camera.target_fraction", [0.29, 0.3], "distance as a multiple of that of equation 6"),
    ("camera.distance_factor", [0.7, 0.8], "distance as a multiple of that of equation 6"),
    ("camera.distance_m", [2.0, 12.0], "camera.distance_m is"),
    ("camera.elevation_deg", [3.0, 4.0], "camera.elevation_deg is"),
    ("camera.ground_clearance", 8.0, "the camera's place (ground)"),
    ("camera.obstacle_clearance", 12.0, "the camera's place (obstacles and vehicles)"),
    ("camera.visible_fraction", [0.2, 0.9], "visible_fraction is"),
    ("camera.visibility_rays", 77, "visible_fraction, which is not the poses'"),
    ("camera.truncated_fraction", [0.1, 0.2], "truncated_fraction is"),
    ("camera.min_box_px", 300.0, "smaller side of the box is"),
    ("camera.max_tries", 1, "cameras tried"),
    ("budget.images_per_class", 11, "25 images, the budget is 28"),
    ("budget.background_share", 0.3, "5 backgrounds, their budget is 9"),
    ("budget.background_distractors", 1.0, "index, position, shot and vehicle"),
    ("budget.images_per_position", 3, "index, position, shot and vehicle"),
    ("budget.positions_per_vehicle", 2, "25 images, the budget is 15"),
    ("light.hdris", [{"name": "noon", "weight": 1.0}], "hdri, which has no weight"),
    ("light.yaw_deg", [0.0, 90.0], "hdri_yaw_deg is"),
    ("light.strength", [0.7, 0.8], "strength is"),
    ("light.overcast", ["noon"], "hdri, which has no weight"),
    *((f"weather.{kind}", 0.0, "weather, which is not what was drawn") for kind in ("fog", "rain", "snow", "dust")),
    ("weather.visibility_m", [300.0, 400.0], "weather.visibility_m is"),
    ("weather.rain_mm_h", [2.0, 2.1], "weather.rain_mm_h is"),
    ("weather.snow_visibility_m", [300.0, 301.0], "weather.snow_visibility_m is"),
    ("weather.dust_visibility_m", [200.0, 201.0], "weather.dust_visibility_m is"),
    ("weather.snow_cover", [0.3, 0.31], "weather.snow_cover is"),
    ("weather.vehicle_snow_cover", [0.0, 0.01], "weather.vehicle_snow_cover is"),
    ("weather.dust_cover", [0.0, 0.01], "weather.dust_cover is"),
    ("weather.vehicle_dust_cover", [0.1, 0.11], "weather.vehicle_dust_cover is"),
    ("weather.wind_m_s", [0.0, 0.1], "weather.wind_m_s is"),
    ("weather.exposure_s", 0.01, "weather.exposure_s is"),
    ("weather.min_contrast", 0.999, "air_contrast is"),
    ("render.width", 1900, "width and height"),
    ("render.height", 1000, "width and height"),
]  # fmt: skip


# With which seed and least size a plan has a companion whose label is ignored for this alone.
FLOORS = [("annotate.min_box_px", 3, 100.0), ("annotate.min_visible_fraction", 7, 100.0)]


def test_every_checked_key_is_changed_below():
    assert {key for key, *_ in CHANGES + FLOORS} == {key for limit in LIMITS for key in limit.keys}


@pytest.mark.parametrize(("key", "seed", "least"), FLOORS, ids=[key for key, *_ in FLOORS])
def test_a_floor_that_was_lowered_is_found(assets, tmp_path, key, seed, least):
    config = small_config(
        seed=seed,
        assets={"distractors": DISTRACTOR_ENTRIES},
        budget={"images_per_class": 10, "images_per_position": 2},
        placement={"min_valid_share": 0.4, "vehicles_per_image": 2, "companion_distance": [9, 30], "fording_depth": 9},
        camera={"visible_fraction": [0.2, 1.0], "distance_m": [2, 60], "min_box_px": least},
        weather={"fog": 0.5},
    )
    plan = write_plan(config, assets, tmp_path / "plan.jsonl")
    assert check_plan(plan, assets) == []
    header, _, rest = plan.path.read_bytes().partition(b"\n")
    changed = json.loads(header)
    changed["config"]["annotate"][key.split(".")[1]] = 0.0
    plan.path.write_bytes(json.dumps(changed, separators=(",", ":")).encode() + b"\n" + rest)
    assert any(".label, which is" in finding for finding in map(str, check_plan(read_plan(plan.path), assets)))


@pytest.mark.parametrize(("key", "value", "message"), CHANGES, ids=[f"{key}: {m[:20]}" for key, _, m in CHANGES])
def test_a_changed_header_is_found(made, assets, tmp_path, key, value, message):
    header, _, rest = made.path.read_bytes().partition(b"\n")
    changed = json.loads(header)
    *sections, name = key.split(".")
    at = changed["config"]
    for section in sections:
        at = at[section]
        if isinstance(at, list) and section != "hdris":
            at = at[0]
    at[name] = value
    if key == "budget.positions_per_vehicle":
        at["images_per_class"] = None
    path = tmp_path / "plan.jsonl"
    path.write_bytes(json.dumps(changed, separators=(",", ":")).encode() + b"\n" + rest)
    findings = check_plan(read_plan(path), assets)
    assert any(message in finding for finding in findings), findings[:20]


@pytest.mark.parametrize("whose", ["target", "companions", "distractors"])
def test_a_part_that_its_vehicle_lacks_is_one_line(made, assets, tmp_path, whose):
    header, *lines = map(json.loads, made.path.read_bytes().splitlines())
    number = next(i for i, line in enumerate(lines) if whose == "target" or line[whose])
    vehicle = lines[number] if whose == "target" else lines[number][whose][0]
    vehicle["articulation"]["crane"] = 0.5
    path = tmp_path / "plan.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in (header, *lines)))
    plan = read_plan(path)
    found = [line for line in check_plan(plan, assets) if line.startswith("image ")]
    assert found == [f"image {number}: vehicle {vehicle['vehicle']!r} has no part 'crane' to turn"]
    with pytest.raises(
        ConfigError, match=rf"plan\.jsonl: image {number}: part 'crane' is not known to the plan; [^\n]*$"
    ):
        Artist(plan, assets).picture(list(plan)[number], width=8)


def table():
    """The lines of the docs' table, one a limit."""
    return [
        f"| {limit.name} | {' '.join(f'`{key}`' for key in limit.keys)} | {limit.of} | {limit.how} | "
        + " ".join(dict.fromkeys(f"`{r.key}`" for r in (limit.below, limit.above) if r))
        + " |"
        for limit in LIMITS
    ]


def test_the_docs_have_every_limit():
    lines = DOCS.read_text().splitlines()
    head = lines.index("|---|---|---|---|---|")
    assert lines[head + 1 : head + 1 + len(LIMITS)] == table()
    reasons = [f"| `{key}` | {reason} |" for key, reason in NOT_RECOMPUTED.items()]
    head = lines.index("|---|---|")
    assert lines[head + 1 : head + 1 + len(reasons)] == reasons
