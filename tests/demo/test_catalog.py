"""The demo assets: content, interpretation, and reproducibility by seed."""

import json
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hulldown.assets.bundle import load_vehicle
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.errors import AssetError, ConfigError
from hulldown.demo import make_assets, project
from hulldown.demo.catalog import (
    CIVILIAN_NAMES,
    DISTRACTOR_FILES,
    DISTRACTORS,
    LAUNCHER_CLASS,
    SCENERY_FILES,
    SCENERY_NAMES,
    SKY_NAMES,
    TRUCK_CLASS,
    VEHICLE_CLASSES,
    VEHICLE_FILES,
)
from hulldown.plan.config.schema import Config
from hulldown.planning.search.budget import make_budget
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import export_asset
from hulldown.tests.builders.blender_plans import run_python
from hulldown.tests.builders.parameters import few
from hulldown.tests.builders.shapes import vertices_at

# Prints hashes of the pose and the evaluated points of each object, without rounding.
FINGERPRINT = """
import hashlib, json, sys
import bpy, numpy as np
for path in sys.argv[1:]:
    bpy.ops.wm.open_mainfile(filepath=path, load_ui=False, use_scripts=False)
    digest, kinds, count = hashlib.sha256(), {}, 0
    seen = set()
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        thing = instance.object
        kinds[thing.type] = kinds.get(thing.type, 0) + 1
        count += instance.is_instance
        digest.update(np.array(instance.matrix_world).tobytes() + thing.name.encode())
        if thing.type in ("MESH", "CURVES") and thing.data.name not in seen:
            seen.add(thing.data.name)
            points = thing.data.attributes["position"].data
            xyz = np.empty(3 * len(points), np.float32)
            points.foreach_get("vector", xyz)
            digest.update(xyz.tobytes())
    print("FILE " + json.dumps({"digest": digest.hexdigest(), "kinds": kinds, "instances": count}))
"""


def _build(folder: Path, *names: str, seed: int = 0) -> Path:
    run_python("-m", "hulldown.demo", folder, "--seed", seed, "--only", *names)
    return folder


def _fingerprints(*paths: Path) -> list[dict]:
    lines = run_python("-c", FINGERPRINT, *paths).splitlines()
    return [json.loads(line[5:]) for line in lines if line.startswith("FILE ")]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """A function that builds files of these names once, and returns their folder."""
    return cache(lambda *names: _build(tmp_path_factory.mktemp("demo"), *names))


def _read(path: Path, folder: Path, **options: object) -> tuple[FileReport, VehicleShape]:
    exported = export_asset(path, folder, options=Options(**options))
    shape = load_vehicle(exported.bundle)
    assert not exported.report.missing
    assert 1_000 <= len(shape.mesh.faces) <= 60_000
    np.testing.assert_allclose(shape.mesh.bounds[0][2], 0, atol=1e-6)
    return exported.report, shape


def test_building_keeps_existing_files_and_continues_after_a_crash(tmp_path, monkeypatch):
    fake = tmp_path / "hulldown" / "demo"
    fake.mkdir(parents=True)
    for package in (fake.parent, fake):
        (package / "__init__.py").write_text("")
    # A stand-in for Blender: "builds" nine files, then crashes.
    (fake / "__main__.py").write_text(
        "import os, pathlib, signal, sys\n"
        "folder, only = pathlib.Path(sys.argv[1]), sys.argv[5:]\n"
        f"files = { {Path(file).stem: file for file in make_assets.ASSET_FILES} }\n"
        "for name in only[:9]:\n"
        "    path = folder / files[name]\n"
        "    path.parent.mkdir(exist_ok=True)\n"
        "    path.write_text('built')\n"
        f"    print('{make_assets.BUILT_LINE_PREFIX}' + str(path), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    mine = tmp_path / "out" / VEHICLE_FILES[1]
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    steps: list[tuple[int, int]] = []
    for _ in range(2):  # the second finds nothing to build
        files = make_assets.build_demo_assets(tmp_path / "out", progress=lambda done, total: steps.append((done, total)))
        assert files == tuple(tmp_path / "out" / file for file in make_assets.ASSET_FILES)
        assert steps == [(k + 2, len(files)) for k in range(len(files) - 1)]
    assert [file.read_text() for file in files] == ["built", "mine", *["built"] * (len(files) - 2)]
    monkeypatch.setattr(make_assets, "MAX_ATTEMPTS", 2)
    with pytest.raises(AssetError, match="could not build"):
        make_assets.build_demo_assets(tmp_path / "other")


def test_the_config_of_a_project_names_every_asset(tmp_path, monkeypatch):
    monkeypatch.setattr(project, "build_demo_assets", lambda folder, **_: None)
    config = project.create_project(tmp_path / "mine")
    parsed = tomllib.loads(config.read_text(encoding="utf-8"))
    assert [v["path"] for v in parsed["assets"]["vehicles"]] == list(VEHICLE_FILES)
    assert [v["category"] for v in parsed["assets"]["vehicles"]] == list(VEHICLE_CLASSES.values())
    assert [s["path"] for s in parsed["assets"]["sceneries"]] == list(SCENERY_FILES)
    assert [d["path"] for d in parsed["assets"]["distractors"]] == list(DISTRACTOR_FILES)
    assert (parsed["render"]["width"], parsed["render"]["profile"]) == (1920, "paper")
    with pytest.raises(ConfigError, match="is there already"):
        project.create_project(tmp_path / "mine")


def test_a_small_project_has_twelve_small_images(tmp_path, monkeypatch):
    monkeypatch.setattr(project, "build_demo_assets", lambda folder, **_: None)
    parsed = tomllib.loads(project.create_project(tmp_path, small=True).read_text(encoding="utf-8"))
    budget = make_budget(Config.of(parsed).budget, VEHICLE_CLASSES)
    assert (budget.n_images, budget.images.sum()) == (12, 10)
    assert set(budget.images.tolist()) == {1}  # each vehicle once
    assert parsed["render"]["width"] == 480


@pytest.mark.blender
def test_the_same_seed_makes_the_same_vehicles(built, tmp_path):
    vehicles, names = built(*VEHICLE_CLASSES), ("mbt_slab", "truck_canvas")
    again = _build(tmp_path / "again", *names)
    files = [f"vehicles/{name}.blend" for name in names]
    assert _fingerprints(*(vehicles / f for f in files)) == _fingerprints(*(again / f for f in files))
    texture = "vehicles/textures/desert_blocks.png"
    assert (vehicles / texture).read_bytes() == (again / texture).read_bytes()


@pytest.mark.blender
@pytest.mark.thorough
def test_sceneries_are_reproducible_and_change_with_the_seed(built, tmp_path):
    path = "sceneries/dry_steppe.blend"
    same, other = (_build(tmp_path / str(seed), "dry_steppe", seed=seed) for seed in (0, 1))
    one, two, three = _fingerprints(built(*SCENERY_NAMES) / path, same / path, other / path)
    assert one == two
    assert one["digest"] != three["digest"]


@pytest.mark.blender
def test_sceneries_have_copies_instances_and_clutter_like_real_files(built):
    for found in _fingerprints(*(built(*SCENERY_NAMES) / path for path in SCENERY_FILES)):
        assert found["kinds"]["CAMERA"] == 1
        assert found["kinds"]["CURVES"] > 1000
        assert found["instances"] > 2000  # by collections and geometry nodes
        assert found["kinds"]["MESH"] - found["instances"] > 1500  # copies of one mesh


@pytest.mark.blender
@pytest.mark.parametrize("name", few(VEHICLE_CLASSES, "mbt_slab", "truck_canvas", "sam_rails"))
def test_vehicles_are_read_as_intended(built, name, tmp_path):
    report, shape = _read(built(*VEHICLE_CLASSES) / "vehicles" / f"{name}.blend", tmp_path)
    length, width, height = shape.size_xyz
    assert 6.5 < length < 12
    assert 2.5 < width < 4.1
    assert 2.4 < height < 7.5
    assert length > width  # the nose points along x
    assert len(shape.mesh.faces) >= 5_000
    assert shape.part_names == (("hull",) if VEHICLE_CLASSES[name] == TRUCK_CLASS else ("hull", "turret", "gun"))
    assert {row.name for row in report.rows if row.use == "dropped"} >= {"Floor", "Grid", "Camera", "Sun"}
    if VEHICLE_CLASSES[name] != TRUCK_CLASS:
        # Raising the gun moves it up in front of its pivot and moves nothing else.
        rest, raised = vertices_at(shape, {}), vertices_at(shape, {"gun": 0.2})
        moved = np.abs(raised - rest).max(axis=1) > 1e-9
        assert moved.any()
        assert set(shape.vertex_part[moved]) == {shape.part_names.index("gun")}
        tip = rest[:, 0].argmax() if VEHICLE_CLASSES[name] != LAUNCHER_CLASS else np.flatnonzero(moved)[rest[moved, 0].argmax()]
        assert raised[tip, 2] > rest[tip, 2]


@pytest.mark.blender
@pytest.mark.parametrize("name", few(tuple(dict.fromkeys((*DISTRACTORS, *CIVILIAN_NAMES))), "civilian_car", "bus", "classic"))
def test_distractors_are_read_as_intended(built, name, tmp_path):
    _, shape = _read(built(*DISTRACTORS, *CIVILIAN_NAMES) / "distractors" / f"{name}.blend", tmp_path)
    assert (np.array([3.5, 1.7, 1.2 if name == "roadster" else 1.4]) < shape.size_xyz).all()
    assert (shape.size_xyz < np.array([12.0, 4.0, 4.5])).all()
    assert shape.part_names == ("hull",)


@pytest.mark.blender
def test_computed_skies_have_their_stated_brightness(tmp_path):
    code = """
import sys, json
import bpy, numpy as np
from pathlib import Path
from hulldown.demo import skies
skies.SKY_WIDTH_PX = 512
for name in sys.argv[2:]:
    path = skies.render_sky_hdri(name, Path(sys.argv[1]))  # before `bpy.data` is asked: it starts a new file
    image = bpy.data.images.load(str(path))
    w, h = image.size
    light = np.empty(w * h * image.channels, np.float32)
    image.pixels.foreach_get(light)
    light = light.reshape(h, w, -1)[..., :3].mean(-1)
    rise = (np.arange(h) + 0.5) / h * np.pi - np.pi / 2
    falls = np.maximum(np.sin(rise), 0) * np.cos(rise) * np.pi / h * 2 * np.pi / w
    row, column = np.unravel_index(light.argmax(), light.shape)
    sky = skies.SKY_RECIPES[name]
    found = (light * falls[:, None]).sum() / np.pi, np.degrees(rise[row]), column / w
    print("SKY " + json.dumps([*map(float, found), sky.light, sky.sun_elevation_deg]))
"""
    names = ("sky_noon", "sky_evening")
    assert set(names) < set(SKY_NAMES)
    lines = run_python("-c", code, tmp_path, *names).splitlines()
    lights = [json.loads(line[4:]) for line in lines if line[:4] == "SKY "]
    assert len(lights) == len(names)
    for light, rise, column, wanted_light, wanted_rise in lights:
        assert light == pytest.approx(wanted_light, rel=0.02)
        assert rise == pytest.approx(wanted_rise, abs=1.0)
        assert column == pytest.approx(0.5, abs=0.01)
    assert not list(tmp_path.glob(".*"))
