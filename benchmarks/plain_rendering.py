"""Renders jobs the plain way, as scripts of this kind do: everything is loaded again for each image.

Started as a child, `python -P plain_rendering.py`, with a JSON list of jobs (see `render.messages`) on stdin; answers
with the seconds of each image as a JSON list.
"""

import json
import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import bpy
import numpy as np

from render.blender import cycles
from render.blender.scene import Stage
from render.messages import from_json


def main() -> None:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    seconds = []
    for job in map(from_json, json.load(sys.stdin)):
        start = time.perf_counter()
        stage = Stage(job.scenery.path, np.array(job.scenery.scenery_from_file))
        cycles.configure(stage.scene, job.settings, device="CPU")
        stage.scene.render.use_persistent_data = False
        stage.scene.world.cycles.sampling_method = "AUTOMATIC"
        stage.place_vehicles(job.vehicles)
        stage.set_camera(job.camera)
        stage.set_light(job.light)
        stage.scene.cycles.seed = job.seed
        stage.scene.render.filepath = job.output
        bpy.ops.render.render(write_still=True, scene=stage.scene.name)
        seconds.append(time.perf_counter() - start)
    json.dump(seconds, answers)
    answers.close()


main()
