"""A node of a cluster: one Blender, supervised as on a single machine, that lives from parcel to parcel.

Made when the first parcel comes, in the process that Dask calls a worker. It ends with that process, however that ends:
Blender's end of the pipe between them is closed then, see `render.blender.worker`.
"""

from __future__ import annotations

import os
import platform
import threading
import time
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from geometry.errors import HulldownError
from render.confinement import Confinement
from render.kept import Kept, cache_folder
from render.messages import RenderJob, to_json
from render.parcels import (
    Answer,
    Failure,
    Parcel,
    Picture,
    decode_parcel,
    decode_piece,
    decode_versions,
    encode,
    named_files,
    versions,
)
from render.png import damage
from render.pool import Limits, Pool

SHARE_VARIABLE = "HULLDOWN_SHARE"  # how many workers share this machine's cores and memory
IDLE_S = 60.0  # after which Blender is ended: it holds memory
NEVER = 2**31  # whether an error is the cluster's or the plan's is for the client to judge


def render_parcel(client: bytes, parcel: bytes, scratch: Path) -> bytes:
    """Render what a client has sent.

    Parameters
    ----------
    client, parcel
        `Versions` and `Parcel`, encoded: what a client of another version has sent may be no parcel of this one.
    scratch
        Folder on a disk of this machine.

    Returns
    -------
    An encoded `Answer`.
    """
    theirs = decode_versions(client)
    if wrong := versions().difference(theirs):
        return encode(Answer(refused=wrong))
    return encode(_node(scratch).render(decode_parcel(parcel)))


def keep_piece(piece: bytes) -> bytes:
    """Add a piece to a file that this machine lacks; see `render.kept.Kept.keep`."""
    _kept().keep(decode_piece(piece))
    return b""


@cache
def _kept() -> Kept:
    return Kept(cache_folder())


@cache
def _node(scratch: Path) -> Node:
    return Node(scratch, _kept(), share=max(1, int(os.environ.get(SHARE_VARIABLE, "1"))))


@dataclass(frozen=True, slots=True)
class _Setting:
    """What a Blender was started with; for something else another is started."""

    write: Path
    read: frozenset[Path]
    device: str
    image_s: float | None


class Node:
    """A Blender and what it has been started with.

    Parameters
    ----------
    scratch
        Folder for logs and unfinished pictures.
    kept
        The files that pictures are made from.
    share
        How many nodes share this machine.
    """

    def __init__(self, scratch: Path, kept: Kept, *, share: int = 1) -> None:
        self._scratch, self._kept, self._share = scratch, kept, share
        self._name = uuid.uuid4().hex
        self._pool: Pool | None = None
        self._setting: _Setting | None = None
        self._held: int | None = None  # the folder that Blender writes to, open
        self._lines: list[str] = []
        self._busy = threading.Lock()
        self._idle = threading.Timer(IDLE_S, self.close)

    def render(self, parcel: Parcel) -> Answer:
        """Render a parcel, or say what is missing for it."""
        self._idle.cancel()
        with self._busy:
            answer = self._render(parcel)
        self._idle = threading.Timer(IDLE_S, self.close)
        self._idle.daemon = True
        self._idle.start()
        return answer

    def _render(self, parcel: Parcel) -> Answer:
        began = time.monotonic()
        try:
            if lacking := [sha256 for asset in parcel.assets for sha256 in self._kept.lacking(asset)]:
                return Answer(lacking=list(dict.fromkeys(lacking)))
            here = {asset.file.path: self._kept.place(asset) for asset in parcel.assets}
            read = [folder for asset in parcel.assets for folder in self._kept.readable(asset)]
            pool = self._pool_for(parcel, read)
            restarts = pool.restarts
            pictures, failures = self._run(pool, parcel, here)
        except HulldownError as error:
            self._end()
            return Answer(refused=str(error))
        lines, self._lines[:] = list(self._lines), []
        return Answer(
            pictures=pictures,
            failures=failures,
            folder=self._name if parcel.shared else "",
            lines=lines,
            restarts=pool.restarts - restarts,
            seconds=time.monotonic() - began,
            blender=pool.blender_version,
            system=platform.platform(terse=True),
        )

    def close(self) -> None:
        """End Blender, once it is idle; the next parcel starts another."""
        with self._busy:
            self._end()

    def _end(self) -> None:
        if self._pool is not None:
            self._pool.__exit__(None, None, None)
        if self._held is not None:
            os.close(self._held)
        self._pool = self._setting = self._held = None

    def _is_gone(self) -> bool:
        """Whether the folder that Blender may write to was deleted: Landlock knows another of its name as another."""
        assert self._held is not None
        try:
            return os.fstat(self._held).st_nlink == 0
        except OSError:  # of a network disk
            return True

    def _run(self, pool: Pool, parcel: Parcel, here: dict[str, Path]) -> tuple[list[Picture], list[Failure]]:
        assert self._setting is not None
        folder, orders = self._setting.write, parcel.orders
        pictures: list[Picture] = []
        failures: list[Failure] = []

        def output(i: int) -> Path:
            return folder / f"{orders[i].index}.png"

        def done(i: int, answer: Mapping[str, Any]) -> str | None:
            camera = orders[i].job.camera
            if wrong := damage(output(i), camera.width, camera.height):
                return wrong
            png = b""
            if not parcel.shared:
                png = output(i).read_bytes()
                output(i).unlink()
            pictures.append(Picture(orders[i].index, png, answer["device"]))
            return None

        pool.run(
            range(len(orders)),
            lambda i: to_json(_moved(orders[i].job, here, output(i))),
            done,
            lambda i, reasons: failures.append(Failure(orders[i].index, reasons)),
        )
        return pictures, failures

    def _pool_for(self, parcel: Parcel, read: Iterable[Path]) -> Pool:
        """The Blender that is there, if it may do what this parcel needs; otherwise a new one."""
        write = self._shared(Path(parcel.shared)) if parcel.shared else self._scratch / "pictures"
        write.mkdir(parents=True, exist_ok=True)
        had = self._setting
        setting = _Setting(write, frozenset(read), parcel.device, parcel.image_s)
        if had is not None:
            setting = replace(setting, read=had.read | setting.read)  # so that it is not started again and again
        if self._pool is None or setting != had or self._is_gone():
            self._end()
            self._setting, self._held = setting, os.open(write, os.O_RDONLY)
            self._pool = Pool(
                self._scratch / "logs",
                device=parcel.device,
                workers=1,
                limits=Limits(job_s=parcel.image_s, give_up_after=NEVER),
                say=self._lines.append,
                confinement=Confinement(write, tuple(sorted(setting.read)), gpu=parcel.device != "cpu"),
                share=self._share,
            )
        return self._pool

    def _shared(self, folder: Path) -> Path:
        if not folder.is_dir():
            raise HulldownError(
                "is not there", path=folder, remedy="leave out --shared-disk, or mount it on all machines"
            )
        return folder / self._name


def _moved(job: RenderJob, here: dict[str, Path], output: Path) -> RenderJob:
    """A job with the paths that its files have on this machine."""
    places = {path: str(here[path].resolve()) for path in named_files(job)}
    scenery = replace(job.scenery, path=places[job.scenery.path])
    vehicles = [replace(vehicle, tidy=places[vehicle.tidy]) for vehicle in job.vehicles]
    light = replace(job.light, hdri=places[job.light.hdri])
    return replace(job, scenery=scenery, vehicles=vehicles, light=light, output=str(output))
