"""Plans: complete, within their limits, the same bytes for any number of workers, and clear errors."""

from dataclasses import replace

import numpy as np
import pytest

from hulldown.assets.plan_assets import AssetSource, HdriSource
from hulldown.base.errors import ConfigError
from hulldown.geometry.meshes import merge_meshes_with_sources
from hulldown.plan.lines import PlanWriter
from hulldown.plan.row import ModelSource, encode_line, encode_rows
from hulldown.planning.planner import Planner
from hulldown.planning.search.instance_table import articulated_bounds
from hulldown.planning.search.stage import make_stage
from hulldown.planning.write import make_plan_header, write_plan
from hulldown.tests.builders.planning_assets import bare, hills, plan, small_assets, small_config, vehicle
from hulldown.tests.builders.shapes import box

ASSETS = small_assets()


@pytest.fixture(scope="module")
def rows():
    return list(plan(small_config(), ASSETS))


def test_everything_varies(rows):
    assert len({row.scenery for row in rows}) == 2
    assert len({row.hdri for row in rows}) == 2
    for key in ("fov_x_deg", "hdri_yaw_deg", "strength", "sample_seed"):
        assert len({getattr(row, key) for row in rows}) == len(rows)
    turrets = {row.target.articulation["turret"] for row in rows}
    assert len(turrets) == len({row.position for row in rows})
    assert min(turrets) < -1.0 < 1.0 < max(turrets)


def test_a_longer_plan_keeps_the_rows_of_a_shorter_one():
    short = list(plan(small_config(budget={"images_per_class": 8}), ASSETS))
    longer = list(plan(small_config(budget={"images_per_class": 16}), ASSETS))
    assert encode_rows(longer[: len(short)]) == encode_rows(short)


def test_seeds_differ_and_0_is_valid(rows):
    other = list(plan(small_config(seed=1), ASSETS))
    assert not any(np.array_equal(a.world_from_camera, b.world_from_camera) for a, b in zip(rows, other, strict=True))


@pytest.mark.parametrize("workers", [1, 3])
def test_the_bytes_do_not_depend_on_the_number_of_workers(tmp_path, rows, workers, monkeypatch):
    monkeypatch.setattr("hulldown.planning.write._MIN_BLOCK_POSITIONS", 2)
    seen = []
    path = tmp_path / "plan.jsonl"
    made = write_plan(small_config(), ASSETS, path, workers=workers, progress=lambda *done: seen.append(done))
    assert encode_rows(list(made)) == encode_rows(rows)
    assert made.path.read_bytes().split(b"\n", 1)[1] == b"".join(map(encode_line, rows))
    assert seen[0] == (0, 22)
    assert seen[-1] == (22, 22)
    assert seen == sorted(seen)


@pytest.mark.parametrize("kept", [0, 3, 4, 22])
def test_a_killed_plan_is_continued_with_the_same_bytes(tmp_path, rows, kept):
    config, path = small_config(), tmp_path / "plan.jsonl"
    header = make_plan_header(Planner(config, ASSETS), path)
    writer = PlanWriter(path, header)
    writer.write(encode_rows(rows[:kept]) + b'{"index":', kept)
    writer.__exit__(KeyboardInterrupt, None, None)
    assert (tmp_path / "plan.jsonl.partial").exists() == (kept > 0)
    done = []
    made = write_plan(config, ASSETS, path, progress=lambda n, _: done.append(n))
    assert done[0] == {0: 0, 3: 0, 4: 4, 22: 22}[kept]
    assert made.path.read_bytes() == b"".join(map(encode_line, [header, *rows]))


def test_the_header_has_the_plans_inputs(tmp_path):
    vehicles = {"t72": AssetSource(path="vehicles/t72.blend", sha256="ab" * 32)}
    hdris = {"noon": HdriSource(path="hdris/noon.exr", sha256="cd" * 32)}
    made = replace(ASSETS, files={"vehicles": vehicles, "hdris": hdris})
    config = small_config(seed=5)
    header = write_plan(config, made, tmp_path / "plan.jsonl").header
    assert header.seed == 5
    assert header.images == 22
    assert header.vehicles["t72"] == ModelSource(path="vehicles/t72.blend", sha256="ab" * 32, category="tank")
    assert header.sceneries["hills"].origin == (500000.0, 5400000.0, 120.0)
    assert header.hdris["noon"].sha256 == "cd" * 32
    assert header.config == config.model_dump(mode="json")
    assert {"python", "numpy", "embreex"} <= set(header.versions)


def test_without_ground_vehicles_are_on_the_fallback_plane():
    for row in plan(small_config(ground={"fallback_z": 3.5}), small_assets(bare("bare", origin_z=1.0))):
        assert row.target.world_from_vehicle[2].tolist() == [0.0, 0.0, 1.0, 2.5]
        assert (row.target.gap, row.target.penetration, row.target.slope_deg) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        (
            {"placement": {"max_slope_deg": 0.001, "max_tries": 100}},
            r"'t72' on scenery 'hills' finds no place to stand: of [\d,]+ tries 100 % were too steep at the spot; "
            r"widen the limits in \[placement\]",
        ),
        (
            {"camera": {"min_box_px": 1900, "max_tries": 3}},
            r"cannot be seen as wanted: of [\d,]+ tries \d+ % were smaller than camera.min_box_px",
        ),
        ({"budget": {"images_per_class": {"tank": 1}}}, "no number for the class 'truck'"),
        ({"budget": {"images_per_class": {"tank": 1, "truck": 1, "jet": 1}}}, "no vehicle has the class 'jet'"),
        ({"budget": {"images_per_class": 0}}, "no image would be made"),
        ({"light": {"hdris": ["night*"]}}, r"light.hdris: 'night\*' matches no HDRI; assets.hdris gives noon, dusk"),
        ({"light": {"hdris": [{"name": "noon", "weight": 0}]}}, "light.hdris: all weights are 0"),
    ],
)
def test_an_impossible_config_is_explained(sections, message, monkeypatch):
    monkeypatch.setattr("hulldown.planning.search.positions.MAX_PLACES_WITHOUT_CAMERA", 2)
    with pytest.raises(ConfigError, match=message):
        list(plan(small_config(**sections), small_assets(hills("hills"))))


def test_errors_of_workers_are_raised(tmp_path, monkeypatch):
    monkeypatch.setattr("hulldown.planning.write._MIN_BLOCK_POSITIONS", 2)
    config = small_config(placement={"max_slope_deg": 1.5, "max_tries": 20})
    with pytest.raises(ConfigError, match="finds no place to stand"):
        write_plan(config, small_assets(hills("hills")), tmp_path / "p.jsonl", workers=2)
    assert list(tmp_path.iterdir()) == []


def test_an_unseen_plate_neither_carries_a_vehicle_nor_needs_room():
    """It's below the tracks and wider than the vehicle."""
    shape, plate = vehicle("t72"), box((-9.0, -9.0, -1.0), (9.0, 9.0, -0.9))
    part = np.append(shape.vertex_part, np.zeros(len(plate.vertices), dtype=int))
    mesh, _ = merge_meshes_with_sources([shape.mesh, plate])
    hidden = replace(shape, mesh=mesh, vertex_part=part, seen=shape.mesh, seen_part=shape.vertex_part)
    assets = small_assets(vehicles=("t72",))
    fleets = [make_stage(small_config(), replace(assets, vehicles={"t72": one})).fleet for one in (shape, hidden)]
    wanted, got = fleets
    rest = np.zeros((1, len(shape.part_names)))
    for bounds in (articulated_bounds(fleet, np.array([0]), rest) for fleet in fleets):  # of rows, and so of bbox_3d
        np.testing.assert_allclose(np.ptp(bounds[0], axis=0), shape.size_xyz, rtol=0, atol=1e-8)
    for name in ("size", "center", "half", "box_center", "reach"):
        np.testing.assert_array_equal(getattr(got, name), getattr(wanted, name), err_msg=name)
    for name in ("xy", "height"):
        pair = (getattr(fleet.footings[0].contact, name) for fleet in (got, wanted))
        np.testing.assert_array_equal(*pair, err_msg=name)


def test_equal_files_under_other_names_are_prepared_once():
    shape, land = vehicle("t72").with_keypoints({}), hills("hills")
    shapes = {"a": shape, "b": replace(shape, name="b"), "c": replace(shape, part_limits=shape.part_limits / 2)}
    assets = small_assets(vehicles=("t72",))
    assets = replace(
        assets,
        vehicles=shapes,
        categories=dict.fromkeys(shapes, "tank"),
        sceneries={"hills": land, "again": replace(land, name="again")},
    )
    stage = make_stage(small_config(), assets)
    a, b, c = stage.fleet.models
    assert a.caster is b.caster is not c.caster
    assert [model.shape for model in (a, b, c)] == list(shapes.values())
    assert [site.name for site in stage.sites] == ["hills", "again"]
    assert stage.sites[0].terrain is stage.sites[1].terrain
