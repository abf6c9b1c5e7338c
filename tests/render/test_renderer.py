"""Cycles renders what was planned, whatever the settings in the files."""

import math
import os
import pickle
import queue
import re
import shlex
import subprocess
import sys
import time
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import psutil
import pytest

from hulldown.annotate.masks import mask_box, mask_iou
from hulldown.annotate.silhouettes import whole_and_visible_masks
from hulldown.base.child import Child
from hulldown.base.errors import HulldownError
from hulldown.camera.shell import outward_and_camera_axes
from hulldown.cli import main
from hulldown.dataset.provenance import read_failures, read_provenance_by_plan
from hulldown.geometry.transforms import rigid_matrix
from hulldown.plan.library import load_planned_library
from hulldown.plan.plan_file import Plan
from hulldown.render.cycles_masks import render_index_maps_of_rows, verify_masks
from hulldown.render.jobs import blender_readable_paths, make_mask_job
from hulldown.render.process import WORKER_SCRIPT, Allowance, Blender, Limits, worker_command
from hulldown.render.supervisor import render_remaining_images
from hulldown.render.verify import verify_dataset
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster
from hulldown.tests.builders.blender_plans import draw, drawn, job, make_plan, pixels, run_python
from hulldown.tests.builders.clusters import digests, wait_for
from hulldown.tests.builders.plan_lines import altered
from hulldown.tests.builders.render_plans import moved
from hulldown.tests.oracles.rendered import assert_shows_plan
from hulldown.verbs.output import FOUND

pytestmark = pytest.mark.blender
CONFIG = {
    "assets": {
        "hdris": ["gray.exr", "sky.exr", "bright_side.exr"],
        "sceneries": [{"path": f"{name}.blend"} for name in ("field", "centimeters", "map")],
    },
    "budget": {"images_per_class": 8, "images_per_position": 1},
    "camera": {"visible_fraction": [0.2, 1.0], "truncated_fraction": [0.0, 0.6], "framing": 1.0},
    "placement": {"vehicles_per_image": [1, 2], "companion_distance": [9.0, 20.0]},
    "light": {"hdris": ["bright_side"], "exposure": 0.0, "exposure_error_ev": 0.0},
    "render": {"width": 128, "height": 72, "samples": 4, "denoise": False, "bounces": 2},
}


@pytest.fixture(scope="module")
def plan(own_worlds):
    return make_plan(own_worlds, seed=5, **CONFIG)


@pytest.fixture(scope="module")
def dataset(plan, library, own_worlds):
    report = render_remaining_images(plan.path, own_worlds / "dataset", library=library)
    assert report.complete
    assert_shows_plan(own_worlds / "dataset", plan, library)
    return own_worlds / "dataset"


def test_killing_blender_and_then_the_run_loses_and_doubles_nothing(plan, dataset, own_worlds):
    killed = own_worlds / "killed"
    command = [sys.executable, "-P", "-m", "hulldown.cli", "render", str(plan.path), "-o", str(killed)]
    with subprocess.Popen([*command, "--device", "cpu"], stderr=subprocess.DEVNULL) as run:
        wait_for(run, killed, 2)
        psutil.Process(run.pid).children()[-1].kill()
        wait_for(run, killed, 4)
        run.kill()
    assert render_remaining_images(plan.path, killed).complete
    assert digests(killed) == digests(dataset)


def test_the_command_limits_the_time_of_a_picture(plan, blender, tmp_path):
    hanging = tmp_path / "blender"
    hanging.write_text(Path(blender).read_text().replace("exec", "FAILS=hang exec"))
    hanging.chmod(0o755)
    options = ["--limit", "1", "--blender", str(hanging), "--image-timeout", "0.25"]
    assert main(["render", str(plan.path), "-o", str(tmp_path / "d"), *options]) == FOUND
    (failure,) = read_failures(tmp_path / "d")
    assert failure.reasons == ["no answer within 0.25 s"] * 3


def standing(library, target):
    shape = library.shapes[target.vehicle]
    return PosedVehicle(VehicleCaster(shape), target.world_from_vehicle[None], target.articulation)


def pink(picture):
    return (picture[..., 0] > picture[..., 1] + 60) & (picture[..., 2] > picture[..., 1] + 60)


def test_cycles_and_embree_see_the_same_pixels(plan, library):
    assert {row.scenery for row in plan} == {"field", "centimeters", "map"}
    assert any(row.companions for row in plan)
    assert any(row.target.truncated_fraction > 0 for row in plan)
    for row, (_, *maps) in zip(plan, render_index_maps_of_rows(plan, range(len(plan)), library), strict=True):
        for number, (target, alone) in enumerate(zip(row.vehicles, maps, strict=True), start=1):
            assert mask_iou(alone == number, whole_and_visible_masks(standing(library, target), row.camera)[1]) >= 0.99
        # All parts of the tank are thicker than a pixel: the outermost pixel centers are within one pixel of the box.
        assert np.abs(corners(mask_box(maps[0] == 1)) - corners(row.target.bbox)).max() <= 1.0


def corners(xywh):
    x, y, w, h = xywh
    return np.array([x, y, x + w, y + h])


def test_pictures_show_the_planned_vehicles(dataset, plan, library):
    """The tank glows pink in a gray world, so its pixels can be counted."""
    for row in plan:
        expected = np.zeros((row.height, row.width), dtype=bool)
        world = Scene.from_scenery(library.assets.sceneries[row.scenery])
        for target in row.vehicles:
            expected |= whole_and_visible_masks(standing(library, target), row.camera, world=world)[1]
        # Antialiased edges: one pixel more or less on every side.
        assert mask_iou(pink(pixels(dataset / row.file_name)), expected) > 0.8


def test_a_row_gives_the_same_picture_in_any_order_and_process(dataset, plan, library, tmp_path):
    order = [3, 0, 3]
    pictures = draw(tmp_path, [(plan[i], library) for i in order])
    assert np.array_equal(pictures[0], pictures[2])
    for picture, i in zip(pictures, order, strict=True):
        assert np.array_equal(picture, pixels(dataset / plan[i].file_name))


def looking(azimuth_deg, elevation_deg, *, fov_x_deg=60.0, at=(0.0, 0.0, 40.0)):
    """Fields of a row whose camera is at `at` and looks in a direction."""
    _, axes = outward_and_camera_axes(math.radians(azimuth_deg + 180.0), math.radians(-elevation_deg))
    return {"world_from_camera": rigid_matrix(axes, np.array(at)), "width": 128, "height": 72, "fov_x_deg": fov_x_deg}


def test_the_sky_turns_counter_clockwise_with_yaw(plan, library, own_worlds, tmp_path):
    """A bright patch at azimuth 0 appears at azimuth yaw."""
    walls = replace(library, sceneries={"field": moved(library.sceneries["field"], own_worlds / "walls.blend")})
    turns = []
    for yaw_deg in (0.0, 75.0, -120.0):
        camera = looking(yaw_deg, 20.0, at=(0.0, 0.0, 4000.0))
        turns.append((altered(plan[0], **camera, scenery="field", hdri="sky", hdri_yaw_deg=yaw_deg, companions=[]), walls))
    for picture in draw(tmp_path, turns):
        bright = np.argwhere(picture.min(axis=2) > 230)
        assert len(bright) > 4
        assert np.abs(bright.mean(axis=0) + 0.5 - [36.0, 64.0]).max() < 1.5


def test_render_settings_of_a_twin_do_not_leak(plan, library, own_worlds, tmp_path):
    """The file sets half size, a crop, a raw view, overexposure, a material override, and a black compositor."""
    field = library.sceneries["field"]
    leaking = moved(field, own_worlds / "leaking.blend")
    other = replace(library, sceneries={"field": leaking})
    row = altered(next(row for row in plan if row.scenery != "map"), scenery="field")
    clean, leaked = draw(tmp_path, [(row, library), (row, other)])
    assert np.array_equal(clean, leaked)


def test_scripts_and_drivers_of_a_file_do_not_run(plan, library, own_worlds, worlds, tmp_path):
    evil = moved(library.sceneries["field"], own_worlds / "evil.blend")
    row = altered(plan[0], scenery="field")
    draw(tmp_path, [(altered(row, sample_seed=n), replace(library, sceneries={"field": evil})) for n in (1, 2)])
    assert not (worlds / "registered").exists()
    assert not (worlds / "driven").exists()


NEWER = """
import sys, bpy
bpy.data.libraries.write(sys.argv[1], {bpy.data.collections.new("twin")})
data = open(sys.argv[1], "rb").read()
open(sys.argv[1], "wb").write(data.replace(data[:17], data[:14] + b"999", 1))
"""


def test_a_twin_by_a_newer_blender_is_refused(plan, library, own_worlds, tmp_path):
    run_python("-c", NEWER, own_worlds / "newer.blend")
    newer = replace(library.sceneries["field"], tidy=own_worlds / "newer.blend")
    with pytest.raises(HulldownError, match=r"newer.blend was written by Blender 9.99, newer than the 5.*--cache"):
        draw(tmp_path, [(altered(plan[0], scenery="field"), replace(library, sceneries={"field": newer}))])


def in_place_of_blender(folder, code):
    """Path of a program that runs `code` and then the worker."""
    program = folder / "blender"
    code = f"{code}; sys.argv = [{str(WORKER_SCRIPT)!r}]; runpy.run_path({str(WORKER_SCRIPT)!r}, run_name='__main__')"
    program.write_text(f"#!/bin/sh\nexec {sys.executable} -P -c {shlex.quote('import runpy, sys; ' + code)}\n")
    program.chmod(0o755)
    return str(program)


def test_a_worker_needs_only_numpy_and_bpy(plan, library, tmp_path):
    """An installed Blender has no other packages, so they are hidden from the worker."""
    hidden = ["jaxtyping", "msgspec", "scipy", "orjson", "pydantic", "psutil", "PIL", "filelock", "rich"]
    hidden += ["trimesh", "embreex"]
    program = in_place_of_blender(tmp_path, f"sys.modules.update(dict.fromkeys({hidden!r}))")
    with Blender(tmp_path / "log", program=program) as blender:
        drawn(blender, job(plan[0], library, tmp_path / "0.png"))
        assert blender.do(make_mask_job(plan[0], library, tmp_path / "0.npy")).content


def test_a_blender_without_numpy_is_reported(tmp_path):
    """Debian's Blender doesn't include it."""
    blender = Blender(tmp_path / "log", program=in_place_of_blender(tmp_path, "sys.modules['numpy'] = None"))
    with pytest.raises(HulldownError, match=r"has no numpy; install numpy for that Python$"):
        blender.do({})


def test_a_failed_job_has_a_reason_and_the_next_one_is_done(plan, library, tmp_path):
    good = job(plan[0], library, tmp_path / "0.png")
    skies = (replace(good.light, hdri=str(tmp_path / f"{name}.exr")) for name in ("gone", "cut"))
    bad, cut = (replace(good, light=sky) for sky in skies)
    (tmp_path / "cut.exr").write_bytes(Path(good.light.hdri).read_bytes()[:40])
    with Blender(tmp_path / "log") as blender:
        assert ["gone.exr" in reason for reason in blender.do(bad).reasons] == [True] * 3
        reasons = blender.do(cut).reasons
        assert ["cut.exr: Blender cannot read this picture" in reason for reason in reasons] == [True] * 3
        assert not blender.do(good).reasons


def test_the_sky_changes_in_a_scenery_that_packs_its_pictures(plan, library, own_worlds, tmp_path):
    """With `Automatically Pack Resources` on, the second HDRI was rendered as the first one."""
    field = library.sceneries["field"]
    packing = replace(library, sceneries={"field": moved(field, own_worlds / "leaking.blend")})
    pictures = []
    for a in (replace(library, sceneries={"field": field}), packing):
        with Blender(tmp_path / "log") as blender:
            for hdri in ("sky", "gray", "sky"):
                row = altered(plan[0], **looking(0.0, 20.0), scenery="field", hdri=hdri, hdri_yaw_deg=0.0)
                pictures.append(drawn(blender, job(row, a, tmp_path / f"{len(pictures)}.png")))
    sky, gray, again, *packed = pictures
    assert not np.array_equal(sky, gray)
    for picture, expected in zip(packed, (sky, gray, again), strict=True):
        assert np.array_equal(picture, expected)


@pytest.mark.parametrize("ended_by", ["its supervisor's death", "a job of another version"])
def test_a_worker_ends(plan, library, tmp_path, ended_by):
    heard = queue.SimpleQueue()
    with Child(worker_command(None), env=os.environ, on_line=heard.put, log=tmp_path / "log") as worker:
        assert b"ready" in heard.get(timeout=120)
        worker.write(pickle.dumps(job(plan[0], library, tmp_path / "0.png", samples=1_000_000)))
        time.sleep(1.0)
        if ended_by == "a job of another version":
            worker.write(b"chulldown.rendering.messages\nForgotten\n.")
        else:
            worker.close_stdin()
        assert heard.get(timeout=30) == b""


def test_an_idle_worker_with_one_core_sleeps(plan, library, tmp_path):
    """A Blender limited to one thread kept a core busy while idle."""
    with Blender(tmp_path / "log", allowance=Allowance(Limits(), blenders=psutil.cpu_count())) as blender:
        drawn(blender, job(plan[0], library, tmp_path / "0.png"))
        process = psutil.Process(blender.process_id)
        before = sum(process.cpu_times()[:2])
        time.sleep(2.0)
        assert sum(process.cpu_times()[:2]) - before < 0.5


def test_annotations_of_a_dataset_equal_masks_by_cycles(dataset, plan, library):
    found = [one for one in verify_dataset(dataset, plan.path, assets=lambda: library) if one.severity == "error"]
    assert not [one for one in found if "magenta" not in one.problem]  # the tanks of this world glow pink
    report = verify_masks(dataset, plan.path, count=5, library=library)
    assert len({row.file_name for row in report.rows}) == 5
    assert not [finding for finding in report.findings if finding.severity == "error"]
    assert min(row.mask_iou for row in report.rows if row.pixels > 50) >= 0.99
    assert report.table().row_count == len(report.rows)
    [made] = read_provenance_by_plan(dataset).values()
    assert re.fullmatch(r"5\.\d.*, Python 3\.\d+\.\d+, NumPy \d.*", made.blender[0])


def test_a_path_in_a_plan_gives_no_access_to_its_folder(plan, library, tmp_path):
    """Blender could read the folder of a path in the header."""
    entry = altered(plan.header.sceneries["field"], path=str(tmp_path / "secret" / "field.blend"))
    header = altered(plan.header, sceneries={**plan.header.sceneries, "field": entry})
    found = load_planned_library(Plan(plan.path, header))
    assert blender_readable_paths(found) == blender_readable_paths(library)
    assert plan.path.parent in blender_readable_paths(found)
    assert library.hdris["gray"].path in blender_readable_paths(found)


# A principal point far from the center, and pixels that aren't square; the field of view is 53 degrees wide.
OFF_MIDDLE = ((128.0, 0.0, 40.0), (0.0, 96.0, 60.0), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("fov_x_deg", "matrix", "lens"),
    [
        (0.1, None, None),
        (5.0, None, None),
        (100.0, None, None),
        (179.0, None, None),
        (53.1, OFF_MIDDLE, None),
        (53.1, OFF_MIDDLE, (-0.3, 0.1, 0.01, -0.02, 0.0)),
    ],
)
def test_any_field_of_view_is_rendered_exactly(plan, library, tmp_path, fov_x_deg, matrix, lens):
    """Blender clamps focal lengths."""
    target = VehicleCaster(library.shapes["tank"])
    width = float(library.shapes["tank"].size_xyz[1])
    # Seen from behind, from a distance at which the tank fills half of the frame.
    distance = width / math.tan(math.radians(fov_x_deg / 2)) + 4.0
    row = altered(plan[0], K=matrix, dist=lens, **looking(0.0, 0.0, fov_x_deg=fov_x_deg, at=(-distance, 0.0, 500.7)))
    up = np.eye(4)
    up[2, 3] = 500.0
    row = altered(row, target=altered(row.target, world_from_vehicle=up, articulation={}), companions=[])
    with Blender(tmp_path / "log") as blender:
        seen = np.load(BytesIO(blender.do(make_mask_job(row, library, tmp_path / "m.npy")).content))[1] == 1
    expected = whole_and_visible_masks(PosedVehicle(target, up[None], {}), row.camera)[1]
    assert expected.sum() > 100
    assert mask_iou(seen, expected) >= 0.99
