"""A worker of a cluster: one supervised Blender that stays open from image to image.

Blender starts with the first image and ends with the worker's process in any case: the pipe between
them is closed then, see `rendering.blender.worker`.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from distributed import get_worker

from hulldown.base.child import Stopped
from hulldown.base.code import MISSING, difference, versions
from hulldown.base.errors import HulldownError
from hulldown.cluster.scheduler import SHARE_VARIABLE
from hulldown.cluster.workers import Answer, wanted
from hulldown.reading.confinement import landlock
from hulldown.rendering.asset_files import AssetCache, AssetNote, cache_folder
from hulldown.rendering.blender.messages import RenderJob
from hulldown.rendering.process import Allowance, Blender, Confinement, Limits

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
class Setting:
    """The parameters of a plan's Blenders.

    Parameters
    ----------
    key, readable
        As of `rendering.asset_files.ClientFiles`.
    device
        A device for `rendering.blender.cycles.choose_device`.
    limits
        Limits of Blender.
    """

    key: str
    readable: tuple[Path, ...]
    device: str
    limits: Limits


def render_row(setting: Setting, job: RenderJob, assets: tuple[AssetNote, ...], *contents: bytes) -> Answer:
    """Render an image on this Dask worker.

    Parameters
    ----------
    setting
        Blender's parameters.
    job
        Blender's job, with the client's paths.
    assets
        The assets that it names.
    contents
        Those of files that this worker lacked.

    Returns
    -------
    An answer with a `rendering.process.Outcome`.

    Raises
    ------
    HulldownError, OSError
        If this machine can't render at all.
    """
    is_wanted, opened = wanted(), _open_blender()
    with opened.busy(setting):
        kept = {opened.cache.keep(content) for content in contents}
        lacking = tuple({digest: None for asset in assets for digest in opened.cache.lacking(asset)})
        if lost := kept.intersection(lacking):
            raise HulldownError(f"{cache_folder()} does not keep {min(lost)[:12]}")
        if lacking:
            return Answer(lacking=lacking)
        here = {asset[0].path: str(opened.cache.place(asset).resolve()) for asset in assets}
        output = (opened.pictures / "picture").with_suffix(Path(job.output).suffix)
        job_here = replace(
            job,
            scenery=here[job.scenery],
            vehicles=[replace(vehicle, tidy=here[vehicle.tidy]) for vehicle in job.vehicles],
            light=replace(job.light, hdri=here[job.light.hdri]),
            output=str(output),
        )
        try:
            outcome = opened.blender.do(job_here, stopping=lambda: not is_wanted())
        except Stopped:
            return Answer()
        output.unlink(missing_ok=True)
        lines, opened.lines[:] = tuple(opened.lines), []
        return Answer(outcome, has_failed=bool(outcome.reasons), lines=lines)


@cache
def _open_blender() -> OpenBlender:
    """Return the process's Blender."""
    return OpenBlender(Path(get_worker().local_directory) / "hulldown")


class OpenBlender:
    """The Blender of a Dask worker, its copies of files, and unsent `lines` for the user; it writes to `scratch`."""

    blender: Blender  # this and the cache are for the setting of the last `busy`
    cache: AssetCache

    def __init__(self, scratch: Path) -> None:
        self._scratch, self.pictures = scratch, scratch / "pictures"
        self.pictures.mkdir(parents=True, exist_ok=True)
        self._setting: Setting | None = None
        self.lines: list[str] = []
        self._busy = threading.Lock()
        self._idle = threading.Timer(IDLE_S, self._end_idle)

    def _end_idle(self) -> None:
        with self._busy:
            if self._setting is not None:
                self.blender.close()  # the next image starts another

    @contextmanager
    def busy(self, setting: Setting) -> Iterator[None]:
        """Have a Blender and a cache for a setting during the block; Blender stays open for `IDLE_S` after it."""
        self._idle.cancel()
        try:
            with self._busy:
                if setting != self._setting:
                    self._set(setting)
                yield
        finally:
            self._idle = threading.Timer(IDLE_S, self._end_idle)
            self._idle.daemon = True
            self._idle.start()

    def _set(self, setting: Setting) -> None:
        if self._setting is not None:
            self.blender.close()
        self._setting = None  # should any of this fail
        self.cache = AssetCache(cache_folder(), setting.key)
        self.blender = Blender(
            self._scratch / "logs" / "blender.log",
            device=setting.device,
            allowance=Allowance(setting.limits, max(1, int(os.environ.get(SHARE_VARIABLE, "1")))),
            confinement=Confinement(self.pictures, (self.cache.tree, *setting.readable)),
            say=self.lines.append,
        )
        if why := landlock.unconfined():
            self.lines.append(f"Blender is not confined there: {why}; see docs/safety.md")
        self._setting = setting
