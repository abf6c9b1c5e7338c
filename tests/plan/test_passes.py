"""Passes: depth, normals, instances, parts, and panoptic segments, against masks, terrain, and the camera."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from hulldown.annotate.masks import mask_box
from hulldown.annotate.silhouettes import whole_and_visible_masks
from hulldown.cli import main
from hulldown.plan.pictures.passes import PASS_MEANINGS, STUFF_CLASSES, write_passes
from hulldown.plan.pictures.preview import Artist
from hulldown.planning.search.stage import make_stage
from hulldown.planning.write import write_plan
from hulldown.tests.builders.cameras import unproject
from hulldown.tests.builders.planning_assets import small_assets, small_config

ASSETS = small_assets(distractors=True)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("passes")
    config = small_config(
        budget={"images_per_class": 2},
        placement={"vehicles_per_image": 4, "companion_distance": [6, 15], "distractors_per_image": 1},
        camera={"elevation_deg": [3, 12], "target_fraction": [0.2, 0.4], "roll_deg": [-30, 30], "visibility_rays": 1024},
        render={"width": 240, "height": 136},
    )
    plan = write_plan(config, ASSETS, folder / "plan.jsonl")
    assert write_passes(plan, folder / "passes", assets=ASSETS) == dict.fromkeys(PASS_MEANINGS, len(plan))
    return plan, folder / "passes"


def read(folder, row):
    """All passes of a row by name, and its table."""
    stem = f"{row.image_id:08d}"
    with np.load(folder / "depth" / f"{stem}.npz") as depth, np.load(folder / "normal" / f"{stem}.npz") as normal:
        arrays = {"axis": depth["axis"], "ray": depth["ray"], "normal": normal["world"]}
    arrays |= {name: np.array(Image.open(folder / name / f"{stem}.png")) for name in ("instance", "part", "panoptic")}
    return arrays, json.loads((folder / "tables" / f"{stem}.json").read_text())


def test_instances_equal_the_vehicles_masks(made):
    plan, folder = made
    artist, hidden = Artist(plan, ASSETS), 0
    for row in plan:
        arrays, table = read(folder, row)
        world = artist.scene(row)
        assert [r["name"] for r in table["instances"][: len(row.vehicles)]] == [v.vehicle for v in row.vehicles]
        for i, vehicle in enumerate(world.vehicles):
            others = world.with_vehicles([v for v in world.vehicles if v is not vehicle])
            mask = whole_and_visible_masks(vehicle, row.camera, world=others)[1]
            assert (mask != (arrays["instance"] == i + 1)).sum() <= 1  # where two objects have the same distance
            alone = whole_and_visible_masks(vehicle, row.camera)[1]
            hidden += int((alone & ~mask).sum())
            if alone.sum() > 200:
                assert row.vehicles[i].visible_fraction == pytest.approx(mask.sum() / alone.sum(), abs=0.1)
    assert hidden > 100


def test_depths_and_normals_equal_those_of_the_ground(made):
    plan, folder = made
    terrains = {site.name: site.terrain for site in make_stage(plan.config, ASSETS).sites}
    for row in plan:
        arrays, table = read(folder, row)
        (ground,) = (record["id"] for record in table["instances"] if record["kind"] == "ground")
        rows, columns = np.nonzero((arrays["instance"] == ground) & (arrays["ray"] < 300.0))  # a plane is unlimited
        pixels, camera = np.stack([columns, rows], 1) + 0.5, row.camera
        axis, ray = (arrays[name][rows, columns].astype(float) for name in ("axis", "ray"))
        points = unproject(camera, pixels, axis)
        assert np.allclose(points, camera.position + ray[:, None] * camera.rays(pixels)[1], rtol=0, atol=1e-3)
        tops = terrains[row.scenery].top_hits(points[:, :2])
        assert np.abs(tops.z - points[:, 2]).max() < 1e-3
        normal = arrays["normal"][rows, columns]
        assert np.quantile(np.abs(normal - tops.normal).max(axis=1), 0.99) < 1e-5  # except where two faces meet
        sky = arrays["instance"] == 0
        assert np.isinf(arrays["axis"][sky]).all()
        assert np.isnan(arrays["normal"][sky]).all()
        assert np.isfinite(arrays["ray"][~sky]).all()
        lengths = np.linalg.norm(arrays["normal"][~sky], axis=1)
        assert np.abs(lengths - 1.0).max() < 1e-6


def test_parts_are_the_movable_ones(made):
    plan, folder = made
    parts = {record["id"]: record for record in json.loads((folder / "parts.json").read_text())}
    seen = set()
    for row in plan:
        arrays, _ = read(folder, row)
        assert ((arrays["part"] > 0) == np.isin(arrays["instance"], np.arange(len(row.vehicles)) + 1)).all()
        for i, vehicle in enumerate(row.vehicles):
            shown = [parts[p] for p in np.unique(arrays["part"][arrays["instance"] == i + 1])]
            assert {part["vehicle"] for part in shown} <= {vehicle.vehicle}
            seen |= {part["part"] for part in shown}
    assert {"hull", "turret", "gun"} <= seen


def test_panoptic_segments_have_cocos_format(made):
    plan, folder = made
    document = json.loads((folder / "panoptic.json").read_text())
    names = {category["id"]: category["name"] for category in document["categories"]}
    assert list(names.values()) == [*plan.header.categories, *STUFF_CLASSES]
    assert len(document["annotations"]) == len(plan)
    for row, annotation in zip(plan, document["annotations"], strict=True):
        colors = np.array(Image.open(folder / "panoptic" / annotation["file_name"])).astype(int)
        numbers = colors @ [1, 256, 65536]
        segments = {segment["id"]: segment for segment in annotation["segments_info"]}
        assert set(np.unique(numbers).tolist()) == set(segments)
        for number, segment in segments.items():
            mask = numbers == number
            assert segment["area"] == mask.sum()
            assert segment["bbox"] == list(mask_box(mask))
        instance = read(folder, row)[0]["instance"]
        for i, vehicle in enumerate(row.vehicles, start=1):
            shown = numbers[instance == i]
            if len(shown):
                (number,) = np.unique(shown).tolist()
                assert names[segments[number]["category_id"]] == (vehicle.category or "distractor")
                assert segments[number]["iscrowd"] == (vehicle.label == "ignored")


def test_finished_images_are_kept_and_changed_ones_are_made_again(made, tmp_path, monkeypatch, capsys):
    (plan, folder), out = made, tmp_path / "out"
    library = SimpleNamespace(assets=ASSETS)
    monkeypatch.setattr("hulldown.plan.pictures.passes.load_planned_library", lambda *_, **__: library)
    assert main(["passes", str(plan.path), "-o", str(out), "--part", "--count", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"part": 1}
    assert sorted(p.name for p in out.glob("[!.]*")) == ["part", "parts.json", "tables"]
    part = out / "part" / "00000001.png"
    part.write_bytes(b"kept")
    write_passes(plan, out, part=True, count=1, assets=ASSETS)
    assert part.read_bytes() == b"kept"
    write_passes(plan, out, count=1, assets=ASSETS)
    assert part.read_bytes() == (folder / "part" / "00000001.png").read_bytes()
    lines = plan.path.read_text().splitlines(keepends=True)
    lines[1] = lines[1].replace('"sample_seed":', '"sample_seed":1')
    (tmp_path / "edited.jsonl").write_text("".join(lines))
    part.write_bytes(b"old")
    write_passes(tmp_path / "edited.jsonl", out, count=1, assets=ASSETS)
    assert part.read_bytes() != b"old"
