"""Rows rendered by the workers of a Dask cluster, in place of a `render.pool.Pool`; the only module that knows Dask.

The client deals out the rows itself, as they are needed: a parcel of neighbours is a task for one worker alone,
and no worker has more than two. So there is nothing for Dask to steal, and no task counts how many workers were lost:
the client sees that one is gone and gives its rows to others. Dask's `allow_other_workers` would do that too, but on
workers without the resource that rendering needs as well.
"""

from __future__ import annotations

import asyncio
import logging
import math
import queue
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec
from distributed import Client, Future, Security, get_worker

from geometry.errors import HulldownError
from render.jobs import RenderAssets
from render.kept import note
from render.messages import RenderJob
from render.node import keep_piece, render_parcel
from render.parcels import (
    PIECE,
    Answer,
    AssetNote,
    FileNote,
    Order,
    Parcel,
    Piece,
    decode_answer,
    encode,
    named_files,
    versions,
)
from render.pool import POLL_S, Limits, Stopped
from render.scheduler import Scheduler
from render.shares import Shares

RESOURCE = "render"  # what `dask worker --resources "render=1"` says that a worker may do
IN_FLIGHT = 2  # parcels a worker has: one that it renders, and the next
FEWEST, MOST = 4, 16  # rows of a parcel, but for the end of a plan
PARCEL_S = 10.0  # that a parcel should take
LOOK_S = 1.0  # how often is asked which workers there are
GONE_S = 15.0  # how long a scheduler may be out of reach
STRIKES = 3  # images that a worker fails at and others do not, until it gets no more


@dataclass(eq=False, slots=True)
class _Flight:
    """A task on its way: rows to render by their positions, or a piece of a file."""

    future: Future
    positions: Sequence[int] = ()


@dataclass(eq=False, slots=True)
class _Node:
    """A worker of the cluster."""

    address: str
    flights: list[_Flight] = field(default_factory=list)  # the oldest first, which is the one that it renders
    pieces: Iterator[Piece] | None = None  # of files that it lacks
    sent: set[str] = field(default_factory=set)
    row_s: float = math.inf  # how long an image takes
    strikes: int = 0
    refused: bool = False
    open: bool = True  # whether it takes tasks


class ClusterPool:
    """The workers of a Dask cluster. Leaving it as a context takes back what they have not begun.

    Parameters
    ----------
    scheduler
        Where they are asked for.
    assets
        What the plan is rendered from.
    shared
        Folder that pictures are rendered into if the workers see the same disk.
    device
        What `render.blender.cycles.choose_device` takes.
    limits
        When a row is given up.
    say
        Called with a line for the user, now and then.
    stopping
        Asked several times a second whether to give up now.

    Raises
    ------
    HulldownError
        If the scheduler is not there.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        assets: RenderAssets,
        *,
        shared: Path,
        device: str = "auto",
        limits: Limits,
        say: Callable[[str], None],
        stopping: Callable[[], bool],
    ) -> None:
        self.restarts = 0
        self.devices: set[str] = set()
        self.systems: set[str] = set()
        self.blender_version = ""
        self._scheduler, self._device, self._limits = scheduler, device, limits
        self._shared = shared if scheduler.shared_disk else None
        self._say, self._stopping = say, stopping
        self._references = _references(assets)
        self._notes: dict[str, AssetNote] = {}
        self._files: dict[str, str] = {}  # path by SHA-256
        self._nodes: dict[str, _Node] = {}
        self._refusals: dict[str, str] = {}
        self._events: queue.SimpleQueue[tuple[_Node, _Flight, bytes | BaseException]] = queue.SimpleQueue()
        self._looked = self._reached = 0.0
        self._told = -1
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters of it is said below
        self._client = _connect(scheduler)
        self._say(f"dashboard: {self._client.dashboard_link}")

    def run(
        self,
        jobs: Sequence[int],
        message: Callable[[int], Mapping[str, Any]],
        done: Callable[[int, dict[str, Any]], str | None],
        failed: Callable[[int, list[str]], None],
    ) -> None:
        """Do all jobs; parameters and errors as of `render.pool.Pool.run`."""
        self._jobs, self._message, self._done, self._failed = jobs, message, done, failed
        self._shares = Shares(len(jobs))
        self._tried: dict[int, dict[str, list[str]]] = {}  # reasons by position and worker
        self._lost: dict[int, list[str]] = {}  # by position, the workers that went while they rendered it
        self._outputs: dict[int, str] = {}
        self._left, self._failed_in_a_row = len(jobs), 0
        self._reached = time.monotonic()
        while self._left:
            if self._stopping():
                raise Stopped
            self._look()
            for node in self._nodes.values():
                self._feed(node)
            try:
                node, flight, outcome = self._events.get(timeout=POLL_S)
            except queue.Empty:
                continue
            if flight in node.flights:  # and not one that was taken away from its worker
                node.flights.remove(flight)
                self._hear(node, flight, outcome)

    def _look(self) -> None:
        """See which workers there are."""
        now = time.monotonic()
        if self._client.status == "running":
            self._reached = now
        elif self._client.status == "closed" or now - self._reached > GONE_S:
            raise HulldownError(
                "the scheduler is out of reach",
                path=self._scheduler.address,
                remedy="start one, and run the same command with its address, which goes on from here",
            )
        if self._client.status != "running" or now < self._looked + LOOK_S:
            return
        self._looked = now
        workers = self._client.scheduler_info()["workers"]
        able = {address: info for address, info in workers.items() if info["resources"].get(RESOURCE, 0) >= 1}
        for address, info in able.items():
            node = self._nodes.setdefault(address, _Node(address))
            node.open = info["status"] == "running"
        for address in self._nodes.keys() - able.keys():
            self._drop(self._nodes.pop(address))
        rendering = len(self._usable())
        if rendering != self._told:
            self._told = rendering
            self._say(f"{rendering} workers render" if rendering != 1 else "1 worker renders")
        if self._nodes and not rendering and all(node.refused for node in self._nodes.values()):
            address, why = list(self._refusals.items())[-1]
            raise HulldownError(f"no worker can render; the last to be refused {why}", path=address)

    def _usable(self) -> list[_Node]:
        return [node for node in self._nodes.values() if node.open and not node.refused]

    def _feed(self, node: _Node) -> None:
        if node.refused or not node.open or self._client.status != "running":
            return
        if node.pieces is not None:
            if not node.flights:
                piece = next(node.pieces, None)
                if piece is not None:
                    self._send(node, (), keep_piece, encode(piece))
                    return
                node.pieces = None
            else:
                return
        while len(node.flights) < IN_FLIGHT:
            usable = self._usable()
            end = math.ceil(self._left / (IN_FLIGHT * len(usable)))
            most = min(max(FEWEST, min(MOST, math.ceil(PARCEL_S / node.row_s))), end)
            positions = self._shares.take(node.address, most, only=len(usable) == 1)
            if not positions:
                return
            self._send(node, positions, _render_here, encode(versions()), encode(self._parcel(positions)))

    def _send(self, node: _Node, positions: Sequence[int], function: Callable[..., Any], *data: bytes) -> None:
        future = self._client.submit(
            function,
            *data,
            key=f"hulldown-{uuid.uuid4().hex}",
            workers=[node.address],
            allow_other_workers=False,
            resources={RESOURCE: 1},
            pure=False,
        )
        flight = _Flight(future, positions)
        node.flights.append(flight)
        assert self._client.loop is not None
        self._client.loop.add_callback(self._listen, node, flight)

    async def _listen(self, node: _Node, flight: _Flight) -> None:
        """Pass on how a task has ended; runs in Dask's own thread."""
        outcome: bytes | BaseException
        try:
            outcome = await self._client.gather(flight.future, asynchronous=True)
        except (Exception, asyncio.CancelledError) as error:
            outcome = error
        self._events.put((node, flight, outcome))

    def _parcel(self, positions: Sequence[int]) -> Parcel:
        orders = []
        for position in positions:
            told = dict(self._message(self._jobs[position]))
            told.pop("do")
            job = msgspec.convert(told, RenderJob)
            self._outputs[position] = job.output
            orders.append(Order(self._jobs[position], job))
        named = sorted({path for order in orders for path in named_files(order.job)})
        return Parcel(
            orders=orders,
            assets=[self._note(path) for path in named],
            device=self._device,
            image_s=self._limits.job_s,
            shared=str(self._shared) if self._shared else "",
        )

    def _note(self, path: str) -> AssetNote:
        if path not in self._notes:
            file = note(Path(path))
            references = [
                note(Path(reference)) for reference in self._references.get(path, ()) if Path(reference).is_file()
            ]
            self._notes[path], self._files[file.sha256] = AssetNote(file, references), path
        return self._notes[path]

    def _hear(self, node: _Node, flight: _Flight, outcome: bytes | BaseException) -> None:
        """A task has ended, well or not."""
        if not isinstance(outcome, BaseException):
            if flight.positions:
                self._take_in(node, flight.positions, decode_answer(outcome))
            return
        if flight.positions:
            self._shares.give_back(flight.positions)
        if self._client.status == "running" and not flight.future.cancelled():
            self._refuse(node, f"fails: {type(outcome).__name__}: {outcome}")

    def _take_in(self, node: _Node, positions: Sequence[int], answer: Answer) -> None:
        for line in answer.lines:
            self._say(f"{node.address}: {line}")
        if answer.refused or answer.lacking:
            self._shares.give_back(positions)
            if answer.refused:
                self._refuse(node, answer.refused)
            elif again := node.sent & {*answer.lacking}:
                self._refuse(node, f"does not keep {self._files[min(again)]}, which it was sent")
            elif node.pieces is None:
                node.sent |= {*answer.lacking}
                node.pieces = _pieces([self._notes[self._files[sha256]].file for sha256 in answer.lacking])
            return
        self.restarts += answer.restarts
        self.blender_version = answer.blender
        self.systems.add(answer.system)
        node.row_s = max(answer.seconds / len(positions), 1e-3)
        by_index = {self._jobs[position]: position for position in positions}
        for picture in answer.pictures:
            if (position := by_index.pop(picture.index, None)) is None:
                continue
            self.devices.add(picture.device)
            output = Path(self._outputs.pop(position))
            self._receive(picture.png, output, answer.folder)
            if wrong := self._done(picture.index, {"done": "render", "device": picture.device}):
                self._attempts_failed(node, position, [wrong])
            else:
                self._rendered(position)
        for failure in answer.failures:
            if (position := by_index.pop(failure.index, None)) is not None:
                self._attempts_failed(node, position, failure.reasons)
        if by_index:
            self._refuse(node, "does not answer for all images that it was sent")
            self._shares.give_back(list(by_index.values()))

    def _receive(self, png: bytes, output: Path, folder: str) -> None:
        """Put a picture where a worker of this machine would have written it."""
        try:
            if self._shared is None:
                output.write_bytes(png)
            elif (left := self._shared / folder / output.name).is_file():
                left.replace(output)
        except OSError as error:
            raise HulldownError(
                f"cannot be written ({error.strerror})",
                path=output,
                remedy="make room and run the same command again, which goes on from here",
            ) from error

    def _rendered(self, position: int) -> None:
        self._left -= 1
        self._failed_in_a_row = 0
        for address in self._tried.pop(position, {}):
            if (node := self._nodes.get(address)) is not None and not node.refused:
                node.strikes += 1
                if node.strikes >= STRIKES:
                    self._refuse(node, f"has failed at {STRIKES} images that others could render")

    def _attempts_failed(self, node: _Node, position: int, reasons: list[str]) -> None:
        """A worker has given a row up; so does the run, once another has too, or if there is no other."""
        tried = self._tried.setdefault(position, {})
        tried[node.address] = reasons
        others = [other for other in self._usable() if other.address not in tried]
        if len(tried) < 2 and others:
            self._shares.give_back([position], avoiding=node.address)
        else:
            self._give_up(position, reasons)

    def _give_up(self, position: int, reasons: list[str]) -> None:
        self._left -= 1
        self._tried.pop(position, None)
        self._failed_in_a_row += len(reasons)
        self._failed(self._jobs[position], reasons)
        if self._failed_in_a_row >= self._limits.give_up_after:
            raise HulldownError(
                f"{self._failed_in_a_row} attempts have failed one after the other, the last with: {reasons[-1]}",
                path=self._scheduler.address,
                remedy="mend the cause and run again, which goes on from here",
            )

    def _refuse(self, node: _Node, why: str) -> None:
        """A worker gets no more rows."""
        if not node.refused:
            node.refused = True
            self._refusals[node.address] = why
            self._say(f"{node.address}: gets no images: it {why}")
        self._shares.leave(node.address)

    def _drop(self, node: _Node) -> None:
        """A worker is gone. What it was rendering is suspected a little: it is tried alone the next time but one."""
        self._shares.leave(node.address)
        flights, node.flights = [flight for flight in node.flights if flight.positions], []
        self._client.cancel([flight.future for flight in flights], force=True)
        for i, flight in enumerate(flights):
            rest = list(flight.positions)
            if i == 0 and not node.refused:
                rest = [position for position in rest if not self._suspect(position, node, alone=len(rest) == 1)]
            if rest:
                self._shares.give_back(rest)
        if not node.refused:
            self._say(f"{node.address}: is gone; others render its images")

    def _suspect(self, position: int, node: _Node, *, alone: bool) -> bool:
        """Note that a worker went while it had a row; whether that settles what becomes of the row."""
        lost = self._lost.setdefault(position, [])
        lost.append(f"{node.address} was lost")
        if alone and len(lost) >= self._limits.attempts:
            self._give_up(position, lost)
            return True
        if len(lost) >= self._limits.attempts - 1:
            self._shares.give_back([position])
            return True
        return False

    def __enter__(self) -> ClusterPool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._client.status == "running":
            self._client.cancel([flight.future for node in self._nodes.values() for flight in node.flights], force=True)
        for node in self._nodes.values():
            node.flights.clear()
        self._client.close(timeout=5)


def _render_here(client: bytes, parcel: bytes) -> bytes:
    """What runs in a worker of the cluster."""
    return render_parcel(client, parcel, Path(get_worker().local_directory) / "hulldown")


def _pieces(files: Sequence[FileNote]) -> Iterator[Piece]:
    """Files cut into pieces that Dask can swallow."""
    for file in files:
        with Path(file.path).open("rb") as content:
            for offset in range(0, max(1, file.size), PIECE):
                yield Piece(file.sha256, offset, file.size, content.read(PIECE))


def _references(assets: RenderAssets) -> dict[str, tuple[str, ...]]:
    """The files that each rendered file refers to, by its path as jobs have it."""
    files = [(vehicle.tidy, vehicle.files) for vehicle in assets.vehicles.values()]
    files += [(scenery.path, scenery.files) for scenery in assets.sceneries.values()]
    return {str(path.resolve()): references for path, references in files}


def _connect(scheduler: Scheduler) -> Client:
    tls = {"tls_ca_file": scheduler.tls_ca, "tls_client_cert": scheduler.tls_cert, "tls_client_key": scheduler.tls_key}
    given = {key: str(path) for key, path in tls.items() if path is not None}
    security = Security(require_encryption=True, **given) if given else None
    address = scheduler.address
    try:
        if address.endswith(".json"):
            if not Path(address).is_file():
                raise HulldownError(
                    "no such file", path=address, remedy="start `dask scheduler --scheduler-file` first"
                )
            return Client(scheduler_file=address, security=security, timeout=GONE_S, set_as_default=False)
        return Client(address, security=security, timeout=GONE_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise HulldownError(
            f"no Dask scheduler answers there ({error})", path=address, remedy="start one with `hulldown cluster`"
        ) from None
