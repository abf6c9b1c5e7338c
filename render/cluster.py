"""Rows rendered by the workers of a cluster, in place of a `render.pool.Pool`.

The client deals the rows out itself, as they are needed: a parcel of neighbours is a task, no worker has more than two,
and each keeps to its own part of the plan as long as it can, so that it seldom has to load a file.
"""

from __future__ import annotations

import math
import queue
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec

from geometry.errors import HulldownError
from render.jobs import RenderAssets
from render.messages import RenderJob
from render.node import keep_piece, render_parcel
from render.parcels import (
    Answer,
    Order,
    Parcel,
    Piece,
    decode_answer,
    encode,
    encode_parcel,
    named_files,
    versions,
)
from render.pool import POLL_S, Limits, Stopped
from render.scheduler import Scheduler
from render.sent import ClientFiles, pieces
from render.shares import Shares
from render.tasks import Task, Tasks, scratch

RESOURCE = "render"  # what `dask worker --resources "render=1"` says that a worker may do
IN_FLIGHT = 2  # parcels a worker has: one that it renders, and the next
FEWEST, MOST = 4, 16  # rows of a parcel, but for the end of a plan
PARCEL_S = 10.0  # that a parcel should take
SENDINGS = 2  # of a file to a worker
STRIKES = 3  # images that a worker fails at and others do not, until it gets no more


@dataclass(eq=False, slots=True)
class _Node:
    """A worker of the cluster.

    Parameters
    ----------
    address
        Dask's.
    parcels
        Tasks and the positions of their rows, the oldest first, which is the one that it renders.
    pieces
        Of files that it lacks and is being sent.
    sending
        The task of such a piece.
    sent
        How often each file was sent, by its SHA-256.
    row_s
        Seconds that an image takes.
    strikes
        Images that it has failed at and another has not.
    refused
        Whether it gets no more.
    open
        Whether it takes tasks.
    """

    address: str
    parcels: dict[Task, Sequence[int]] = field(default_factory=dict)
    pieces: Iterator[Piece] | None = None
    sending: Task | None = None
    sent: Counter[str] = field(default_factory=Counter)
    row_s: float = math.inf
    strikes: int = 0
    refused: bool = False
    open: bool = True


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
        device: str,
        limits: Limits,
        say: Callable[[str], None],
        stopping: Callable[[], bool],
    ) -> None:
        self.restarts = self.submitted = 0
        self.devices: set[str] = set()
        self.systems: set[str] = set()
        self.confinements: set[str] = set()
        self.blender_version = ""
        self._address, self._device, self._limits = scheduler.address, device, limits
        self._shared = shared if scheduler.shared_disk else None
        self._say, self._stopping = say, stopping
        self._files = ClientFiles(assets)
        self._nodes: dict[str, _Node] = {}
        self._refusal = ("", "")  # the last: address and reason
        self._told = -1
        self._tasks = Tasks(scheduler, RESOURCE)
        if dashboard := self._tasks.dashboard:
            self._say(f"dashboard: {dashboard}")

    @property
    def working(self) -> int:
        """How many workers render."""
        return len(self._usable())

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
        while self._left:
            if self._stopping():
                raise Stopped
            self._look()
            if self._tasks.connected:
                for usable in self._usable():
                    self._feed(usable)
            try:
                task, outcome = self._tasks.events.get(timeout=POLL_S)
            except queue.Empty:
                continue
            node = self._nodes.get(task.worker)
            if node is None:
                continue
            if task in node.parcels:  # and not one that was taken away from its worker
                self._hear(node, task, node.parcels.pop(task), outcome)
            elif task is node.sending:
                node.sending = None
                if isinstance(outcome, BaseException) and self._tasks.failed(task):
                    self._refuse(node, f"cannot keep a file: {type(outcome).__name__}: {outcome}")

    def _look(self) -> None:
        """See which workers there are."""
        if (workers := self._tasks.workers()) is None:
            return
        for address, is_open in workers.items():
            self._nodes.setdefault(address, _Node(address)).open = is_open
        for address in self._nodes.keys() - workers.keys():
            self._drop(self._nodes.pop(address))
        n = len(self._usable())
        if n != self._told:
            self._told = n
            self._say({0: "waiting for workers", 1: "1 worker renders"}.get(n, f"{n} workers render"))
        if self._nodes and all(node.refused for node in self._nodes.values()):
            address, why = self._refusal
            raise HulldownError(f"is refused as all workers are: it {why}", path=address)

    def _usable(self) -> list[_Node]:
        return [node for node in self._nodes.values() if node.open and not node.refused]

    def _feed(self, node: _Node) -> None:
        """Give a worker what it can do next: a piece of a file that it lacks, or rows."""
        if node.sending is not None:
            return
        if node.pieces is not None:
            if (piece := next(node.pieces, None)) is not None:
                node.sending = self._tasks.submit(node.address, keep_piece, encode(piece))
                return
            node.pieces = None
        while len(node.parcels) < IN_FLIGHT:
            usable = len(self._usable())
            end = math.ceil(self._left / (IN_FLIGHT * usable))
            most = min(max(FEWEST, min(MOST, math.ceil(PARCEL_S / node.row_s))), end)
            positions = self._shares.take(node.address, most, only=usable == 1)
            if not positions:
                return
            parcel = encode_parcel(self._parcel(positions))
            self.submitted += 1
            node.parcels[self._tasks.submit(node.address, _render_here, encode(versions()), parcel)] = positions

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
            assets=[self._files.asset(path) for path in named],
            device=self._device,
            image_s=self._limits.job_s,
            shared=str(self._shared) if self._shared else "",
        )

    def _hear(self, node: _Node, task: Task, positions: Sequence[int], outcome: bytes | BaseException) -> None:
        """A parcel has come back, rendered or not."""
        if not isinstance(outcome, BaseException):
            self._take_in(node, positions, decode_answer(outcome))
            return
        self._shares.give_back(positions)
        if self._tasks.failed(task):
            self._refuse(node, f"fails: {type(outcome).__name__}: {outcome}")

    def _take_in(self, node: _Node, positions: Sequence[int], answer: Answer) -> None:
        for line in answer.lines:
            self._say(f"{node.address}: {line}")
        if answer.refused or answer.lacking:
            self._shares.give_back(positions)
            if answer.refused:
                self._refuse(node, answer.refused)
            elif node.pieces is None and node.sending is None:  # else this was said before the files came
                self._send(node, answer.lacking)
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
                self._outputs.pop(position)
                self._attempts_failed(node, position, failure.reasons)
        if by_index:
            self._refuse(node, "does not answer for all images that it was sent")
            self._shares.give_back(list(by_index.values()))

    def _send(self, node: _Node, lacking: Sequence[str]) -> None:
        """Begin to send a worker the files of these hashes."""
        node.sent.update(lacking)
        files = [file for sha256 in lacking if (file := self._files.with_hash(sha256)) is not None]
        if len(files) < len(lacking):
            self._refuse(node, "asks for files that no image needs")
        elif lost := [file.path for file in files if node.sent[file.sha256] > SENDINGS]:
            self._refuse(node, f"does not keep {lost[0]}, which it was sent {SENDINGS} times")
        else:
            node.pieces = pieces(files)

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
                path=self._address,
                remedy="mend the cause and run again, which goes on from here",
            )

    def _refuse(self, node: _Node, why: str) -> None:
        """A worker gets no more rows."""
        if not node.refused:
            node.refused = True
            self._refusal = node.address, why
            self._say(f"{node.address}: gets no images: it {why}")
        self._shares.leave(node.address)

    def _drop(self, node: _Node) -> None:
        """A worker is gone. What it was rendering is suspected a little: it is tried alone the next time but one."""
        self._shares.leave(node.address)
        self._tasks.take_back(list(node.parcels))
        for i, positions in enumerate(node.parcels.values()):
            rest = list(positions)
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
        self._tasks.take_back([task for node in self._nodes.values() for task in node.parcels])
        self._tasks.close()


def _render_here(client: bytes, parcel: bytes) -> bytes:
    """What runs in a worker of the cluster."""
    return render_parcel(client, parcel, scratch())
