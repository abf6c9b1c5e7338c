"""Renders a gray card on open land: `python -P gray_cards.py JOBS.json ANSWERS.json`.

A job holds the fields of `Job`; an answer is the mean color, from 0 to 255, of a picture that shows only the card.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from PIL import Image

from hulldown.camera.response import ALBEDO
from hulldown.camera.weather.kinds import airlight
from hulldown.reading.blender.pictures import _write
from hulldown.render.blender import cycles
from hulldown.render.blender.air import Fog
from hulldown.render.blender.light import HdriWorld
from hulldown.render.messages import CyclesSettings, LightInput
from hulldown.tests.render_worlds import box, diffuse

SIDE = 4  # pixels, the least that Blender takes; averaged before the view transform, which is nonlinear
EYE = 0.15  # meters above the card, so that air hardly matters


@dataclass(frozen=True)
class Job:
    """A card under a sky, an array (h, w, 3) in a .npy file with the lowest row first; angles in radians."""

    sky: str
    yaw: float = 0.0
    strength: float = 1.0
    horizon: float | None = None
    visibility_m: float | None = None
    exposure: float = 0.0
    white_balance: float = 0.0


def main() -> None:
    """Render all jobs in a file."""
    jobs = [Job(**job) for job in json.loads(Path(sys.argv[1]).read_text())]
    os.dup2(2, 1)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    box("card", (2.0, 2.0, 1.0), (0.0, 0.0, -0.5), diffuse("card", (ALBEDO,) * 3))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location, camera.data.angle = (0.0, 0.0, EYE), 0.2
    scene.collection.objects.link(camera)
    scene.camera = camera
    world = HdriWorld(scene)
    air = bpy.data.objects.new("fog", bpy.data.meshes.new("fog"))
    scene.collection.objects.link(air)
    fog = Fog(air, world, np.eye(4), 1.0)
    answers = []
    for job in jobs:
        settings = CyclesSettings(4096, denoise=False, adaptive_threshold=0.0, bounces=4)
        cycles.configure(scene, settings, device="CPU", threads=2)
        scene.render.resolution_x = scene.render.resolution_y = SIDE
        sky = Path(job.sky).with_suffix(".exr")
        if not sky.exists():
            _write(np.load(job.sky), str(sky))
        world.set(LightInput(str(sky), job.yaw, job.strength, job.horizon), np.eye(4))
        cycles.expose(scene, settings, job.exposure, job.white_balance)
        fog.clear()
        if job.visibility_m is not None:
            glow, eye = airlight("fog", world.airlight()), np.array([0.0, 0.0, EYE])
            fog.fill("fog", job.visibility_m, glow, eye, below=EYE)
        scene.render.filepath = str(Path(sys.argv[2]).with_suffix(".png"))
        bpy.ops.render.render(write_still=True)
        with Image.open(scene.render.filepath) as picture:
            answers.append(np.asarray(picture.convert("RGB")).mean(axis=(0, 1)).tolist())
    Path(sys.argv[2]).write_text(json.dumps(answers))


if __name__ == "__main__":
    main()
