"""A worker of a cluster: one supervised Blender that stays open from image to image.

Blender starts with the first image and ends with the worker's process in any case: the pipe between
them is closed then, see `render.blender.worker`.
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from distributed import Worker, get_worker
from distributed.diagnostics.plugin import WorkerPlugin

from hulldown.geometry.code import MISSING, difference, versions
from hulldown.geometry.errors import HulldownError
from hulldown.reading.confinement import landlock
from hulldown.render.cluster.asset_files import AssetCache, AssetNote, cache_folder
from hulldown.render.cluster.workers import Answer, wanted
from hulldown.render.confinement import Confinement
from hulldown.render.process import Allowance, Blender, Limits, Stopped

SHARE_VARIABLE = "HULLDOWN_SHARE"  # number of workers that share this machine's cores and memory
PLUGIN = "hulldown-blender"
IDLE_S = 60.0  # of idling, after which Blender is ended to free memory


def refusal(client: Mapping[str, str], require_confinement: bool) -> str:
    """Reason why this process can't render for a client; empty if it can.

    Parameters
    ----------
    client
        The client's versions of hulldown and bpy, which must equal this process's; the client may have no bpy.
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
    """An image to render, as a task's argument.

    Parameters
    ----------
    message
        Blender's job, with the client's paths.
    assets
        The assets that it names.
    key
        `render.cluster.asset_files.ClientFiles.key`.
    device
        A device for `render.blender.cycles.choose_device`.
    limits
        Limits of Blender.
    """

    message: Mapping[str, Any]
    assets: tuple[AssetNote, ...]
    key: str
    device: str
    limits: Limits


def render_row(order: Order, *contents: bytes) -> Answer:
    """Render an image on this Dask worker, with contents of files that it lacked.

    The answer's value is a `render.process.Outcome`.
    """
    worker = get_worker()
    if PLUGIN not in worker.plugins:
        # By the task, not by Client.register_plugin: Dask would end workers that have no hulldown.
        plugin = OpenBlender(Path(worker.local_directory) / "hulldown")
        asyncio.run_coroutine_threadsafe(worker.plugin_add(plugin, name=PLUGIN), worker.loop.asyncio_loop).result()
    is_wanted = wanted()
    return worker.plugins[PLUGIN].render(order, contents, stopping=lambda: not is_wanted())


@dataclass(frozen=True, slots=True)
class _Setting:
    """The parameters of a running Blender; others need another Blender."""

    key: str
    read: frozenset[Path]
    device: str
    limits: Limits


class OpenBlender(WorkerPlugin):
    """The Blender of a Dask worker.

    Parameters
    ----------
    scratch
        Folder for logs and unfinished pictures.
    """

    def __init__(self, scratch: Path) -> None:
        self._scratch, self._pictures = scratch, scratch / "pictures"
        self._share = max(1, int(os.environ.get(SHARE_VARIABLE, "1")))
        self._cache: AssetCache | None = None
        self._blender: Blender | None = None
        self._setting: _Setting | None = None
        self._lines: list[str] = []
        self._busy = threading.Lock()
        self._idle = threading.Timer(IDLE_S, self.close)

    def teardown(self, worker: Worker) -> None:
        """End Blender with the worker."""
        self._idle.cancel()
        if self._blender is not None:
            self._blender.close()

    def close(self) -> None:
        """End an idle Blender; the next image starts another."""
        with self._busy:
            if self._blender is not None:
                self._blender.close()

    def render(self, order: Order, contents: tuple[bytes, ...], *, stopping: Callable[[], bool]) -> Answer:
        """Render an image, or return the missing contents."""
        self._idle.cancel()
        with self._busy:
            try:
                answer = self._render(order, contents, stopping)
            except Stopped:
                answer = Answer()
            except (HulldownError, OSError) as error:
                answer = Answer(refused=f"fails: {error}")
        self._idle = threading.Timer(IDLE_S, self.close)
        self._idle.daemon = True
        self._idle.start()
        lines, self._lines[:] = tuple(self._lines), []
        return replace(answer, lines=lines)

    def _render(self, order: Order, contents: tuple[bytes, ...], stopping: Callable[[], bool]) -> Answer:
        if self._cache is None or self._cache.tree.name != order.key:
            self._cache = AssetCache(cache_folder(), order.key)
        kept = {self._cache.keep(content) for content in contents}
        lacking = tuple({digest: None for asset in order.assets for digest in self._cache.lacking(asset)})
        if lacking:
            lost = kept.intersection(lacking)
            return Answer(
                lacking=lacking, refused=f"does not keep {min(lost)[:12]} in {cache_folder()}" if lost else ""
            )
        here = {asset.file.path: str(self._cache.place(asset).resolve()) for asset in order.assets}
        blender = self._blender_for(order, [path for asset in order.assets for path in self._cache.readable(asset)])
        output = (self._pictures / "picture").with_suffix(Path(order.message["output"]).suffix)
        outcome = blender.do(_moved(order.message, here, output), stopping=stopping)
        output.unlink(missing_ok=True)
        return Answer(outcome, has_failed=bool(outcome.reasons))

    def _blender_for(self, order: Order, read: list[Path]) -> Blender:
        """The open Blender, if its parameters fit an order; otherwise a new one."""
        setting = _Setting(order.key, frozenset(read), order.device, order.limits)
        if (had := self._setting) is not None and had.key == order.key:
            setting = replace(setting, read=had.read | setting.read)  # so that it isn't restarted repeatedly
        if self._blender is None or setting != had:
            if self._blender is not None:
                self._blender.close()
            self._pictures.mkdir(parents=True, exist_ok=True)
            self._setting = setting
            self._blender = Blender(
                self._scratch / "logs" / "blender.log",
                device=order.device,
                allowance=Allowance(order.limits, self._share),
                confinement=Confinement(self._pictures, tuple(sorted(setting.read)), gpu=order.device != "cpu"),
                say=self._lines.append,
            )
        return self._blender


def _moved(message: Mapping[str, Any], here: Mapping[str, str], output: Path) -> dict[str, Any]:
    """Replace a message's paths by those on this machine."""
    scenery, light = message["scenery"], message["light"]
    return {
        **message,
        "scenery": {**scenery, "path": here[scenery["path"]]},
        "vehicles": [{**vehicle, "tidy": here[vehicle["tidy"]]} for vehicle in message["vehicles"]],
        "light": {**light, "hdri": here[light["hdri"]]},
        "output": str(output),
    }
