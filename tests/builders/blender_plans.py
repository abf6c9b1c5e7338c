"""Small plans of files that Blender writes and renders."""

import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_library
from hulldown.planning.write import write_plan
from hulldown.render.blender.messages import CyclesSettings
from hulldown.render.jobs import make_render_job
from hulldown.render.process import Blender

IMAGES = 12


def run_script(name, *arguments, check=True):
    """Run a script of this folder, which may import bpy, with these arguments; return its stdout."""
    return run_python(Path(__file__).with_name(name), *arguments, check=check)


def run_python(*arguments, check=True, cwd=None):
    """Run Python with these arguments; return its stdout."""
    command = [sys.executable, "-P", *map(str, arguments)]
    ran = subprocess.run(command, capture_output=True, text=True, errors="replace", cwd=cwd)
    assert ran.returncode == 0 or not check, ran.stdout[-3000:] + ran.stderr[-3000:]
    return ran.stdout


def plan_in(folder, *, vehicle="tank.blend", scenery="field.blend", images=IMAGES):
    """Plan pictures in a folder with these files and gray.exr; return the plan's path."""
    assets = {"vehicles": [{"path": vehicle, "category": "tank"}], "sceneries": [{"path": scenery}]}
    return make_plan(folder, assets=assets, budget={"images_per_class": images}).path


def make_plan(folder, seed=0, **sections):
    """The plan of a config in a folder with its files; the keys of its sections replace those given here."""
    usual = {
        "assets": {
            "hdris": ["gray.exr"],
            "vehicles": [{"path": "tank.blend", "category": "tank"}],
            "sceneries": [{"path": "field.blend"}],
        },
        "budget": {"images_per_class": IMAGES},
        "camera": {"target_fraction": [0.3, 0.6]},
        "render": {"width": 96, "height": 54, "samples": 2},
    }
    merged = {key: {**usual.get(key, {}), **sections.get(key, {})} for key in {**usual, **sections}}
    config = Config.of({"seed": seed, **merged}, path=folder / "hulldown.toml")
    return write_plan(config, load_library(config).assets, folder / "plan.jsonl")


def job(row, assets, output, samples=4):
    """The job of rendering a row."""
    settings = CyclesSettings(samples, denoise=False, adaptive_threshold=0.0, bounces=2)
    return make_render_job(row, assets, settings, output)


def draw(folder, turns, samples=4, *, as_planned=True):
    """Pictures by a new Blender of rows, each with its assets, in this order; they must show the rows."""
    from hulldown.tests.oracles.rendered import assert_shows_row

    with Blender(folder / "logs" / "log") as blender:
        found = [drawn(blender, job(row, assets, folder / f"{n}.png", samples)) for n, (row, assets) in enumerate(turns)]
    for picture, (row, assets) in zip(found, turns, strict=True):
        if as_planned:
            assert_shows_row(picture, row, assets)
    return found


def drawn(blender, job):
    """A picture (h, w, 3) by a Blender."""
    outcome = blender.do(job)
    assert not outcome.reasons
    return pixels(job.output)


def pixels(path):
    """Pixels (h, w, 3) of a picture."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(np.float64)
