"""Worker processes and their jobs: one that crashes, hangs or uses too much memory costs one attempt and a restart.

Independent of what the jobs do: a job is a JSON object, and so is its answer.
"""

from __future__ import annotations

import platform
import queue
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from hulldown.geometry.errors import HulldownError
from hulldown.reading.confinement import landlock
from hulldown.render.confinement import Confinement
from hulldown.render.messages import StartJob, to_json
from hulldown.render.process import WorkerProcess, worker_command

POLL_S = 0.2  # how often time and memory are looked at
NEARLY = 0.8  # of the memory limit: a worker that has grown so far is replaced between two jobs
GIB = 2**30


@dataclass(frozen=True, slots=True)
class Limits:
    """When a worker is given up.

    Parameters
    ----------
    start_s
        Seconds Blender gets to start.
    job_s
        Seconds a job gets; None for what `patience` makes of the first ones.
    memory_bytes
        Resident memory of one worker; None for its share of nine tenths of the machine's. A worker that ends a job
        above four fifths of it is replaced.
    attempts
        How often a job is tried.
    give_up_after
        Attempts that fail one after the other, over all jobs, before the run is stopped: then it is not the jobs.
    """

    start_s: float = 300.0
    job_s: float | None = None
    memory_bytes: int | None = None
    attempts: int = 3
    give_up_after: int = 30


DEFAULT_LIMITS = Limits()
FIRST_JOBS = 5  # by which the time that the others get is judged
FIRST_JOBS_S = 3600.0  # what they get themselves
TIMES_LONGER = 20.0  # than the longest of them, a job is not thought to be honest
SHORTEST_S = 300.0  # loading another scenery takes its time, however quick the first pictures were


def patience(seconds: Sequence[float]) -> float:
    """Seconds that a job gets after those that took `seconds`, the first first.

    Examples
    --------
    >>> patience([2.0] * 4), patience([2.0] * 5), patience([60.0] * 4 + [90.0, 4000.0])
    (3600.0, 300.0, 1800.0)
    """
    if len(seconds) < FIRST_JOBS:
        return FIRST_JOBS_S
    return max(SHORTEST_S, TIMES_LONGER * max(seconds[:FIRST_JOBS]))


class Stopped(Exception):
    """The pool was told to stop before all jobs were done."""


@dataclass(eq=False, slots=True)
class _Worker:
    """A place in the pool; the process in it may change."""

    number: int
    jobs: deque[int]
    process: WorkerProcess | None = None
    device: str = ""
    ready: bool = False
    current: int | None = None
    began: float = 0.0
    allowed: float = 0.0  # seconds since then
    starts: int = 0  # since it was last ready
    reason: str = ""  # why the last process was lost


class Pool:
    """Worker processes that share out jobs. Leaving it as a context ends them.

    Parameters
    ----------
    logs
        Folder for a log of each worker.
    blender
        An installed Blender, or None for the bpy module of this Python.
    device
        What `render.blender.cycles.choose_device` takes.
    workers
        How many; None for one a GPU.
    limits
        When a worker is given up.
    say
        Called with a line for the user, now and then.
    stopping
        Asked several times a second whether to give up now.
    confinement
        What the workers may read and write; None for everything.
    share
        How many pools like this use the machine at the same time.
    """

    def __init__(
        self,
        logs: Path,
        *,
        blender: str | None = None,
        device: str = "auto",
        workers: int | None = None,
        limits: Limits = DEFAULT_LIMITS,
        say: Callable[[str], None] = lambda line: None,
        stopping: Callable[[], bool] = lambda: False,
        confinement: Confinement | None = None,
        share: int = 1,
    ) -> None:
        if workers is not None and workers < 1:
            raise ValueError(f"workers: expected at least 1, got {workers}")
        self.restarts = 0
        self.devices: set[str] = set()
        self.systems = {platform.platform(terse=True)}
        self.confinements = {landlock.confinement()}
        self.blender_version = ""
        self._logs, self._device, self._limits = logs, device, limits
        self._command = worker_command(blender)
        # The doctor looks at the bpy module only.
        self._remedy = "run `hulldown doctor`" if blender is None else f"see whether `{blender} --background` starts"
        self.stopping = stopping
        self._say, self._confinement = say, confinement
        self._share = share
        self._took: list[float] = []  # seconds of the first jobs
        self._one_per_gpu = workers is None
        self._workers = [_Worker(i, deque()) for i in range(workers or 1)]
        self._events: queue.SimpleQueue[tuple[WorkerProcess, dict[str, Any] | None]] = queue.SimpleQueue()

    @property
    def working(self) -> int:
        """How many workers there are."""
        return len(self._workers)

    def run(
        self,
        jobs: Sequence[int],
        message: Callable[[int], Mapping[str, Any]],
        done: Callable[[int, dict[str, Any]], str | None],
        failed: Callable[[int, list[str]], None],
    ) -> None:
        """Do all jobs, neighbours on one worker; returns when each is done or has failed for good.

        Parameters
        ----------
        jobs
            The caller's numbers for them, in an order in which a worker profits from what it has in memory.
        message
            What to send to the worker for a job.
        done
            Called with a job and its answer, to which the `device` is added; may return why that will not do, which
            makes it a failed attempt.
        failed
            Called with a job and the reason of each attempt.

        Raises
        ------
        Stopped
            If `stopping` said so.
        HulldownError
            If Blender does not start, or nothing succeeds any more.
        """
        self._message, self._done, self._failed = message, done, failed
        self._attempts: dict[int, list[str]] = {}
        self._failed_in_a_row = 0
        self._left = len(jobs)
        n = len(self._workers)
        for i, worker in enumerate(self._workers):
            worker.jobs = deque(jobs[i * len(jobs) // n : (i + 1) * len(jobs) // n])
        while self._left:
            if self.stopping():
                raise Stopped
            for worker in self._workers:
                self._feed(worker)
            try:
                process, answer = self._events.get(timeout=POLL_S)
            except queue.Empty:
                pass
            else:
                for worker in self._workers:
                    if worker.process is process:  # and not one that was given up in the meantime
                        self._hear(worker, process, answer)
            self._watch()

    def _hear(self, worker: _Worker, process: WorkerProcess, answer: dict[str, Any] | None) -> None:
        if answer is None:
            self._lost(worker, f"Blender {process.last_words()}")
        elif "unusable" in answer:
            raise HulldownError(f"Blender cannot be used: {answer['unusable']}", remedy=answer["remedy"])
        elif "ready" in answer:
            self.blender_version = answer["ready"]
            processes = len(self._workers) * self._share
            threads = 0 if processes == 1 else max(1, (psutil.cpu_count() or 1) // processes)
            process.send(to_json(StartJob(self._device, worker.number, threads)))
        elif answer.get("done") == "start":
            self._started(worker, answer)
        elif worker.current is None:
            raise HulldownError(f"Blender cannot be used: {answer.get('failed')}", remedy=self._remedy)
        elif "failed" in answer:
            job, worker.current = worker.current, None
            self._say(f"worker {worker.number}: {answer['failed']}")
            self._attempt_failed(worker, job, answer["failed"])
        else:
            self._finished(worker, process, worker.current, answer)

    def _started(self, worker: _Worker, answer: Mapping[str, Any]) -> None:
        worker.ready, worker.starts = True, 0
        if self._one_per_gpu and len(self._workers) < answer["devices"]:
            self._workers.extend(_Worker(i, deque()) for i in range(len(self._workers), answer["devices"]))
        worker.device = answer["device"]
        self.devices.add(worker.device)
        self._say(f"worker {worker.number} renders on {worker.device}")

    def _finished(self, worker: _Worker, process: WorkerProcess, job: int, answer: dict[str, Any]) -> None:
        worker.current = None
        if len(self._took) < FIRST_JOBS:
            self._took.append(time.monotonic() - worker.began)
        if process.memory > NEARLY * self._memory_limit():
            self._say(f"worker {worker.number} has grown near its memory limit and is replaced")
            process.stop()
            worker.process, worker.ready = None, False
        self._feed(worker)  # it renders on while this process writes
        if wrong := self._done(job, {**answer, "device": worker.device}):
            self._say(f"worker {worker.number}: {wrong}")
            self._attempt_failed(worker, job, wrong)
        else:
            self._left -= 1
            self._failed_in_a_row = 0

    def _feed(self, worker: _Worker) -> None:
        """Give an idle worker its next job, half of the longest queue when its own is empty."""
        if worker.current is not None:
            return
        if not worker.jobs:
            longest = max(self._workers, key=lambda other: len(other.jobs))
            spare = longest.jobs if longest.current is not None else list(longest.jobs)[1:]
            half = [longest.jobs.pop() for _ in range((len(spare) + 1) // 2)]
            worker.jobs.extend(reversed(half))
            if not worker.jobs:
                return
        if worker.process is None:
            self._launch(worker)
        elif worker.ready:
            worker.current = worker.jobs.popleft()
            worker.began, worker.allowed = time.monotonic(), self._job_s()
            worker.process.send(self._message(worker.current))

    def _launch(self, worker: _Worker) -> None:
        log = self._logs / f"worker-{worker.number}.log"
        if worker.starts >= self._limits.attempts:
            raise HulldownError(
                f"Blender has not started {worker.starts} times running: {worker.reason}",
                path=log,
                remedy=self._remedy,
            )
        worker.starts += 1
        worker.began, worker.allowed = time.monotonic(), self._limits.start_s
        try:
            worker.process = WorkerProcess(
                self._command, log, lambda *event: self._events.put(event), self._confinement
            )
        except OSError as error:
            raise HulldownError(f"cannot be started: {error.strerror}", path=self._command[0]) from None

    def _watch(self) -> None:
        for worker in self._workers:
            process = worker.process
            if process is None or (worker.ready and worker.current is None):
                continue
            limit = self._memory_limit()
            if time.monotonic() > worker.began + worker.allowed:
                self._lost(worker, f"no answer within {worker.allowed:g} s")
            elif (held := process.memory) > limit:
                self._lost(worker, f"held {held / GIB:.2f} GiB, more than the limit of {limit / GIB:.2f} GiB")

    def _job_s(self) -> float:
        return patience(self._took) if self._limits.job_s is None else self._limits.job_s

    def _memory_limit(self) -> float:
        if self._limits.memory_bytes is not None:
            return float(self._limits.memory_bytes)
        return 0.9 * float(psutil.virtual_memory().total) / (len(self._workers) * self._share)

    def _lost(self, worker: _Worker, reason: str) -> None:
        """The worker is dead or shall be: blame its job, if it has one."""
        assert worker.process is not None
        worker.process.kill()
        worker.process, worker.ready, worker.reason = None, False, reason
        self.restarts += 1
        self._say(f"worker {worker.number}: {reason}; it is started again")
        job, worker.current = worker.current, None
        if job is not None:
            self._attempt_failed(worker, job, reason)

    def _attempt_failed(self, worker: _Worker, job: int, reason: str) -> None:
        reasons = self._attempts.setdefault(job, [])
        reasons.append(reason)
        self._failed_in_a_row += 1
        if self._failed_in_a_row >= self._limits.give_up_after:
            raise HulldownError(
                f"{self._failed_in_a_row} attempts have failed one after the other, the last with: {reason}",
                path=self._logs,
                remedy="mend the cause and run again, which goes on from here",
            )
        if len(reasons) < self._limits.attempts:
            worker.jobs.append(job)  # at the end, so that others are not kept waiting
        else:
            self._left -= 1
            self._failed(job, reasons)

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            if worker.process is not None:
                worker.process.kill()
                worker.process = None
