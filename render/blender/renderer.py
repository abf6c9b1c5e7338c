"""Do a worker's jobs: load missing assets, pose, render, measure."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from hulldown.render.blender import cycles
from hulldown.render.blender.lens import LENS_DEVICES as LENS_DEVICES
from hulldown.render.blender.messages import BlendJob, CyclesSettings, Job, MaskJob, RenderJob, StartJob
from hulldown.render.blender.object_index import IndexPictures
from hulldown.render.blender.reply import Reply
from hulldown.render.blender.saved_scene import strip_and_save_scene
from hulldown.render.blender.scene import BlenderScene


class Renderer:
    """Renders jobs, keeping the scenery and the device between them."""

    def __init__(self) -> None:
        self._stage: BlenderScene | None = None
        self._index: IndexPictures | None = None
        self._loaded: tuple[type, str] | None = None  # what the stage was set up from
        self._inputs: dict[str, tuple[object, ...]] = {}  # what each part of its scene was last set up from
        self._device = "CPU"
        self._threads = 0

    def forget_assets(self) -> None:
        """Forget all assets in memory, so that the next job loads its assets again."""
        self._stage = self._index = self._loaded = None
        self._inputs = {}

    def do(self, job: Job) -> Reply:
        """Do a job; return the reply."""
        match job:
            case StartJob():
                return self._do_start_job(job)
            case RenderJob():
                return self._render_picture(job)
            case BlendJob():
                strip_and_save_scene(self._prepare_picture_scene(job.picture).scene, job.output)
                self.forget_assets()  # it has lost what the picture doesn't need
                return Reply()
        return self._render_masks(job)

    def _do_start_job(self, job: StartJob) -> Reply:
        self._device, count = cycles.activate_device(job.device, job.index)
        self._threads = job.threads
        return Reply(device=self._device, devices=count)

    def _prepare_stage(self, job: RenderJob | MaskJob) -> BlenderScene:
        wanted = type(job), job.scenery
        if any(job.camera.intrinsics.distortion) and self._device.split()[0] not in LENS_DEVICES:
            problem = f"Cycles renders `camera.distortion` on {' and '.join(LENS_DEVICES)} only, not on {self._device}"
            raise cycles.Unusable(problem, "use --device cpu or optix")
        if self._stage is None or self._loaded != wanted:
            self.forget_assets()
            self._stage = BlenderScene(job.scenery)
            if isinstance(job, MaskJob):
                self._index = IndexPictures(self._stage, device=self._device, threads=self._threads)
            self._loaded = wanted
        return self._stage

    def _prepare_picture_scene(self, job: RenderJob) -> BlenderScene:
        stage = self._prepare_stage(job)
        self._set_if_changed("settings", self._apply_cycles_settings, job.settings)
        self._set_if_changed("vehicles", stage.place_vehicles, job.vehicles)
        self._set_if_changed("camera", stage.set_camera, job.camera)
        self._set_if_changed("light", stage.world.set, job.light)
        camera = job.camera
        self._set_if_changed(
            "exposure", cycles.set_exposure_and_white_balance, stage.scene, job.settings, camera.exposure, camera.white_balance
        )
        stage.set_weather(job.weather, job.seed)
        stage.scene.cycles.seed = job.seed
        return stage

    def _render_picture(self, job: RenderJob) -> Reply:
        start = time.process_time()
        stage = self._prepare_picture_scene(job)
        output = Path(job.output)
        output.unlink(missing_ok=True)  # from a failed attempt
        stage.scene.render.filepath = os.fspath(output)
        posed = time.process_time()
        with _Stopwatch() as watch:
            bpy.ops.render.render(write_still=True, scene=stage.scene.name)
        if not output.is_file():
            raise RuntimeError("Blender has written no picture")
        end = time.process_time()
        seconds = {
            "load": posed - start,
            "sync": watch.sampling - posed,
            "sample": watch.finished - watch.sampling,
            "save": end - watch.finished,
        }
        return Reply(seconds=seconds)

    def _apply_cycles_settings(self, settings: CyclesSettings) -> None:
        assert self._stage is not None
        self._inputs.clear()  # the settings include some of the others
        cycles.configure_scene(self._stage.scene, settings, device=self._device, threads=self._threads)

    def _set_if_changed(self, part: str, setter: Callable[..., object], *inputs: object) -> None:
        """Set up a part of the scene unless the last job had the same inputs, since Cycles rebuilds what is set."""
        if self._inputs.get(part) != inputs:
            self._inputs.pop(part, None)  # in case it fails
            setter(*inputs)
            self._inputs[part] = inputs

    def _render_masks(self, job: MaskJob) -> Reply:
        stage = self._prepare_stage(job)
        assert self._index is not None
        vehicles = stage.place_vehicles(job.vehicles)
        stage.set_camera(job.camera)
        np.save(job.output, self._index.render_vehicle_index_maps(vehicles))
        return Reply()


class _Stopwatch:
    def __enter__(self) -> _Stopwatch:
        self.sampling = self.finished = 0.0
        bpy.app.handlers.render_stats.append(self._note_stats)
        return self

    def __exit__(self, *_: object) -> None:
        bpy.app.handlers.render_stats.remove(self._note_stats)
        self.finished = self.finished or time.process_time()
        self.sampling = self.sampling or self.finished

    def _note_stats(self, stats: str, *_: object) -> None:
        if "Sample " in stats and not self.sampling:
            self.sampling = time.process_time()
        if "Finished" in stats:
            self.finished = time.process_time()
