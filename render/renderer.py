"""What a worker does with a job: load what it needs and does not have, pose, render, measure.

Runs inside Blender; needs numpy and bpy only.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from render import cycles
from render.scene import Stage


class Renderer:
    """Keeps a loaded scenery and its device between jobs."""

    def __init__(self) -> None:
        self._stage: Stage | None = None
        self._device = "CPU"
        self._threads = 0

    def reset(self) -> None:
        """Trust nothing that is in memory: the next job loads everything afresh."""
        self._stage = None

    def do(self, job: Mapping[str, Any]) -> dict[str, Any]:
        """Do one job and say how it went."""
        return {"start": self._start, "render": self._render}[job["do"]](job)

    def _start(self, job: Mapping[str, Any]) -> dict[str, Any]:
        self._device, count = cycles.choose_device(job["device"], job["index"])
        self._threads = job["threads"]
        return {"done": "start", "device": self._device, "devices": count}

    def _render(self, job: Mapping[str, Any]) -> dict[str, Any]:
        start = time.monotonic()
        scenery = job["scenery"]
        if self._stage is None or self._stage.path != scenery["path"]:
            self._stage = None
            stage = Stage(scenery["path"], np.array(scenery["scenery_from_file"]))
            cycles.configure(stage.scene, job["settings"], device=self._device, threads=self._threads)
            self._stage = stage
        stage = self._stage
        stage.place_vehicles(job["vehicles"])
        stage.set_camera(job["camera"])
        stage.set_light(job["light"])
        stage.scene.cycles.seed = job["seed"]
        output = Path(job["output"])
        cycles.image_format(stage.scene, output.suffix)
        stage.scene.render.filepath = os.fspath(output)
        posed = time.monotonic()
        bpy.ops.render.render(write_still=True, scene=stage.scene.name)
        end = time.monotonic()
        if not output.is_file():
            raise RuntimeError("Blender has written no picture")
        return {
            "done": "render",
            "seconds": {"load": posed - start, "render": end - posed},
        }
