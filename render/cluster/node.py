"""A worker of a cluster: one Blender, supervised as on a single machine, that stays open from image to image.

Blender is started when the first image comes and ends with the worker's process, however that ends: the pipe between
them is closed then, see `render.blender.worker`.
"""

from __future__ import annotations

import asyncio
import os
import platform
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from distributed import Worker, get_worker
from distributed.diagnostics.plugin import WorkerPlugin

from hulldown.geometry.code import MISSING, difference, versions
from hulldown.geometry.errors import HulldownError
from hulldown.reading.confinement import landlock
from hulldown.render.cluster.asset_files import AssetCache, AssetNote, cache_folder
from hulldown.render.cluster.workers import wanted
from hulldown.render.confinement import Confinement
from hulldown.render.messages import RenderJob, to_json
from hulldown.render.png import damage
from hulldown.render.pool import Limits, Pool, Stopped

SHARE_VARIABLE = "HULLDOWN_SHARE"  # how many workers share this machine's cores and memory
PLUGIN = "hulldown-blender"
IDLE_S = 60.0  # after which Blender is ended: it holds memory
NEVER = 2**31  # the client judges whether failures have a common cause


def refusal(client: Mapping[str, str], require_confinement: bool) -> str:
    """Why this process can't render for a client; empty if it can.

    Parameters
    ----------
    client
        Its versions of hulldown and bpy, which must be the same here; a client that only plans may have no bpy.
    require_confinement
        Whether Blender must be confined.
    """
    if versions("bpy")["bpy"] == MISSING:
        return "has no bpy"
    if wrong := difference({name: version for name, version in client.items() if version != MISSING}):
        return wrong
    if require_confinement and (why := landlock.unconfined()):
        return f"can't confine Blender: {why}"
    return ""


@dataclass(frozen=True, slots=True)
class Order:
    """An image to render.

    Parameters
    ----------
    job
        What to tell Blender, with the client's paths.
    assets
        Each file that the job names.
    key
        `render.cluster.asset_files.ClientFiles.key`.
    device
        What `render.blender.cycles.choose_device` takes.
    image_s
        Seconds that an image gets; None for what the first ones teach.
    """

    job: RenderJob
    assets: tuple[AssetNote, ...]
    key: str
    device: str
    image_s: float | None


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of an order.

    Parameters
    ----------
    worker
        Address of the worker.
    png
        The picture; empty if there is none.
    reasons
        Why each attempt failed, if all did.
    lacking
        SHA-256 of the files that the worker must be sent first.
    refused
        Why this worker can render nothing; empty if it can.
    lines
        Messages for the user.
    restarts
        How often Blender had to be started again.
    device, blender, system, confinement
        What rendered the picture.
    """

    worker: str
    png: bytes = b""
    reasons: tuple[str, ...] = ()
    lacking: tuple[str, ...] = ()
    refused: str = ""
    lines: tuple[str, ...] = ()
    restarts: int = 0
    device: str = ""
    blender: str = ""
    system: str = field(default_factory=lambda: platform.platform(terse=True))
    confinement: str = field(default_factory=landlock.confinement)


def render_row(order: Order, *contents: bytes) -> Answer:
    """Render an image on the Dask worker that calls this, with contents of files that it lacked."""
    worker = get_worker()
    if PLUGIN not in worker.plugins:
        # By the task, not by Client.register_plugin: Dask would end workers that have no hulldown.
        blender = OpenBlender(Path(worker.local_directory) / "hulldown", worker.address)
        asyncio.run_coroutine_threadsafe(worker.plugin_add(blender, name=PLUGIN), worker.loop.asyncio_loop).result()
    blender = worker.plugins[PLUGIN]
    is_wanted = wanted()
    return blender.render(order, contents, stopping=lambda: not is_wanted())


@dataclass(frozen=True, slots=True)
class _Setting:
    """What a Blender was started with; for something else another is started."""

    key: str
    read: frozenset[Path]
    device: str
    image_s: float | None


class OpenBlender(WorkerPlugin):
    """The Blender of a Dask worker.

    Parameters
    ----------
    scratch
        Folder for logs and unfinished pictures.
    address
        The worker's.
    """

    def __init__(self, scratch: Path, address: str) -> None:
        self._scratch, self._address = scratch, address
        self._share = max(1, int(os.environ.get(SHARE_VARIABLE, "1")))
        self._cache: AssetCache | None = None
        self._pool: Pool | None = None
        self._setting: _Setting | None = None
        self._lines: list[str] = []
        self._busy = threading.Lock()
        self._idle = threading.Timer(IDLE_S, self.close)

    def teardown(self, worker: Worker) -> None:
        """End Blender as the worker ends."""
        self._idle.cancel()
        self._end()

    def close(self) -> None:
        """End Blender once it's idle; the next image starts another."""
        with self._busy:
            self._end()

    def _end(self) -> None:
        if self._pool is not None:
            self._pool.__exit__(None, None, None)
        self._pool = self._setting = None

    def render(self, order: Order, contents: tuple[bytes, ...], *, stopping: Any) -> Answer:
        """Render an image, or tell what is missing for it."""
        self._idle.cancel()
        with self._busy:
            try:
                answer = self._render(order, contents, stopping)
            except Stopped:
                self._end()
                answer = Answer(self._address)
            except (HulldownError, OSError) as error:
                self._end()
                answer = Answer(self._address, refused=f"fails: {error}")
        self._idle = threading.Timer(IDLE_S, self.close)
        self._idle.daemon = True
        self._idle.start()
        lines, self._lines[:] = tuple(self._lines), []
        return replace(answer, lines=lines)

    def _render(self, order: Order, contents: tuple[bytes, ...], stopping: Any) -> Answer:
        if self._cache is None or self._cache.tree.name != order.key:
            self._cache = AssetCache(cache_folder(), order.key)
        kept = {self._cache.keep(content) for content in contents}
        lacking = tuple({digest: None for asset in order.assets for digest in self._cache.lacking(asset)})
        if lacking:
            lost = kept.intersection(lacking)
            refused = f"does not keep {min(lost)[:12]} in {self._cache.contents}" if lost else ""
            return Answer(self._address, lacking=lacking, refused=refused)
        here = {asset.file.path: str(self._cache.place(asset).resolve()) for asset in order.assets}
        pool = self._pool_for(order, [path for asset in order.assets for path in self._cache.readable(asset)])
        pool.stopping = stopping
        return self._run(pool, _moved(order.job, here, self._write / "picture.png"))

    @property
    def _write(self) -> Path:
        return self._scratch / "pictures"

    def _run(self, pool: Pool, job: RenderJob) -> Answer:
        output, restarts = Path(job.output), pool.restarts
        answers: list[Answer] = []

        def done(_: int, answer: Mapping[str, Any]) -> str | None:
            if wrong := damage(output, job.camera.intrinsics.width, job.camera.intrinsics.height):
                return wrong
            answers.append(Answer(self._address, png=output.read_bytes(), device=answer["device"]))
            output.unlink()
            return None

        def failed(_: int, reasons: list[str]) -> None:
            answers.append(Answer(self._address, reasons=tuple(reasons)))

        pool.run([0], lambda _: to_json(job), done, failed)
        return replace(answers[0], restarts=pool.restarts - restarts, blender=pool.blender_version)

    def _pool_for(self, order: Order, read: list[Path]) -> Pool:
        """The Blender that is open, if it may do what an order needs; otherwise a new one."""
        setting = _Setting(order.key, frozenset(read), order.device, order.image_s)
        if (had := self._setting) is not None and had.key == order.key:
            setting = replace(setting, read=had.read | setting.read)  # so that it isn't started again and again
        if self._pool is None or setting != had:
            self._end()
            self._write.mkdir(parents=True, exist_ok=True)
            self._setting = setting
            self._pool = Pool(
                self._scratch / "logs",
                device=order.device,
                workers=1,
                limits=Limits(job_s=order.image_s, give_up_after=NEVER),
                say=self._lines.append,
                confinement=Confinement(self._write, tuple(sorted(setting.read)), gpu=order.device != "cpu"),
                share=self._share,
            )
        return self._pool


def _moved(job: RenderJob, here: Mapping[str, str], output: Path) -> RenderJob:
    """A job with the paths that its files have on this machine."""
    scenery = replace(job.scenery, path=here[job.scenery.path])
    vehicles = [replace(vehicle, tidy=here[vehicle.tidy]) for vehicle in job.vehicles]
    light = replace(job.light, hdri=here[job.light.hdri])
    return replace(job, scenery=scenery, vehicles=vehicles, light=light, output=str(output))
