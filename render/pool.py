"""Worker processes and the jobs they do: what crashes, hangs or grows costs one attempt and a restart.

Knows nothing of pictures: a job is a JSON object and so is its answer.
"""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from geometry.errors import HulldownError
from render.worker import ANSWER

WORKER = Path(__file__).with_name("worker.py")
POLL_S = 0.25  # how often time and memory are looked at
STOP_S = 5.0  # what a worker gets to end by itself
LOG_TAIL = 400  # characters of a worker's last words that go into a reason


@dataclass(frozen=True, slots=True)
class Limits:
    """When a worker is given up.

    Parameters
    ----------
    start_s
        Seconds Blender gets to start.
    job_s
        Seconds a job gets.
    memory_bytes
        Resident memory of one worker; 0 for no limit. A worker that ends a job above four fifths of it is replaced.
    attempts
        How often a job is tried.
    give_up_after
        Attempts that fail in a row, over all jobs, before the run is stopped: then it is not the jobs.
    """

    start_s: float = 300.0
    job_s: float = 3600.0
    memory_bytes: int = 0
    attempts: int = 3
    give_up_after: int = 30


DEFAULT_LIMITS = Limits()


class Stopped(Exception):
    """The pool was told to stop before all jobs were done."""


@dataclass(eq=False, slots=True)
class _Worker:
    """One worker process as the pool sees it."""

    number: int
    jobs: deque[int]
    process: subprocess.Popen[bytes] | None = None
    listener: threading.Thread | None = None
    current: int | None = None
    ready: bool = False
    deadline: float = 0.0
    log: Path = Path()
    log_start: int = 0
    reason: str = ""
    starts: int = 0


class Pool:
    """Worker processes that share out jobs. Leaving it as a context ends them.

    Parameters
    ----------
    logs
        Folder for a log of each worker.
    blender
        An installed Blender, or None for the bpy module of this Python.
    device
        What `render.cycles.choose_device` takes.
    workers
        How many; None for one a GPU.
    limits
        When a worker is given up.
    say
        Called with a line for the user, now and then.
    stopping
        Asked several times a second whether to give up now.
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
    ) -> None:
        self.logs, self.blender, self.device, self.limits = logs, blender, device, limits
        self.restarts = 0
        self._say, self._stopping = say, stopping
        self._one_per_gpu = workers is None
        self._workers = [_Worker(i, deque()) for i in range(workers or 1)]
        self._events: queue.SimpleQueue[tuple[int, subprocess.Popen[bytes], dict[str, Any] | None]]
        self._events = queue.SimpleQueue()

    def run(
        self,
        jobs: Sequence[int],
        message: Callable[[int], Mapping[str, Any]],
        done: Callable[[int, dict[str, Any]], None],
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
            Called with a job and its answer.
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
        self._left = len(jobs)
        self._share_out(jobs)
        while self._left:
            if self._stopping():
                raise Stopped
            for worker in self._workers:
                self._feed(worker)
            try:
                number, process, answer = self._events.get(timeout=POLL_S)
            except queue.Empty:
                pass
            else:
                worker = self._workers[number]
                if worker.process is process:  # and not one that was given up in the meantime
                    self._hear(worker, answer)
            self._watch()

    def _hear(self, worker: _Worker, answer: dict[str, Any] | None) -> None:
        if answer is None:
            self._lost(worker, self._last_words(worker))
        elif "ready" in answer:
            self._send(
                worker, {"do": "start", "device": self.device, "index": worker.number, "threads": self._threads()}
            )
        elif answer.get("done") == "start":
            self._started(worker, answer)
        elif worker.current is None:
            raise HulldownError(f"Blender cannot be used: {answer.get('failed')}", remedy="run `hulldown doctor`")
        elif "failed" in answer:
            job, worker.current = worker.current, None
            self._attempt_failed(worker, job, answer["failed"])
        else:
            self._finished(worker, worker.current, answer)

    def _threads(self) -> int:
        cores = psutil.cpu_count() or 1
        return 0 if len(self._workers) == 1 else max(1, cores // len(self._workers))

    def _share_out(self, jobs: Sequence[int]) -> None:
        n = len(self._workers)
        for i, worker in enumerate(self._workers):
            worker.jobs.extend(jobs[i * len(jobs) // n : (i + 1) * len(jobs) // n])

    def _started(self, worker: _Worker, answer: Mapping[str, Any]) -> None:
        worker.ready, worker.starts = True, 0
        if self._one_per_gpu and len(self._workers) < answer["devices"]:
            self._workers.extend(_Worker(i, deque()) for i in range(len(self._workers), answer["devices"]))
        self._say(f"worker {worker.number}: renders on {answer['device']}")

    def _feed(self, worker: _Worker) -> None:
        """Give an idle worker its next job, taken from the longest queue when its own is empty."""
        if worker.current is not None:
            return
        if not worker.jobs:
            longest = max(self._workers, key=lambda other: len(other.jobs))
            half = len(longest.jobs) // 2 if longest.current is not None or longest.process is None else 0
            worker.jobs.extendleft(longest.jobs.pop() for _ in range(half if len(longest.jobs) > 1 else 0))
            if not worker.jobs:
                return
        if worker.process is None:
            self._launch(worker)
        elif worker.ready:
            worker.current = worker.jobs.popleft()
            worker.deadline = time.monotonic() + self.limits.job_s
            self._send(worker, self._message(worker.current))

    def _launch(self, worker: _Worker) -> None:
        if worker.starts >= self.limits.attempts:
            raise HulldownError(
                f"Blender has not started {worker.starts} times running: {worker.reason}",
                path=worker.log,
                remedy="run `hulldown doctor`",
            )
        command = [sys.executable, "-P", str(WORKER)]
        if self.blender is not None:
            command = [self.blender, "--background", "--factory-startup", "--disable-autoexec", "--python", str(WORKER)]
        self.logs.mkdir(parents=True, exist_ok=True)
        worker.log = self.logs / f"worker-{worker.number}.log"
        with worker.log.open("ab") as log:
            worker.log_start = log.tell()
            # A session of its own: Ctrl-C in the terminal reaches the supervisor alone, which then stops its workers.
            worker.process = subprocess.Popen(
                command,
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                start_new_session=True,
            )
        worker.ready, worker.current = False, None
        worker.starts += 1
        worker.deadline = time.monotonic() + self.limits.start_s
        worker.listener = threading.Thread(target=self._listen, args=(worker.number, worker.process), daemon=True)
        worker.listener.start()

    def _listen(self, number: int, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            text = line.decode("utf-8", "replace")
            if text.startswith(ANSWER):
                self._events.put((number, process, json.loads(text[len(ANSWER) :])))
        self._events.put((number, process, None))

    def _send(self, worker: _Worker, message: Mapping[str, Any]) -> None:
        assert worker.process is not None
        assert worker.process.stdin is not None
        try:
            worker.process.stdin.write(json.dumps(message).encode() + b"\n")
            worker.process.stdin.flush()
        except OSError:  # it has just died, which its closed stdout will tell
            pass

    def _finished(self, worker: _Worker, job: int, answer: dict[str, Any]) -> None:
        worker.current = None
        self._left -= 1
        self._failed_in_a_row = 0
        limit = self.limits.memory_bytes
        if limit and self._memory(worker) > 0.8 * limit:
            self._say(f"worker {worker.number}: has grown near its memory limit and is replaced")
            self._stop(worker)
        self._feed(worker)  # it renders on while this process writes
        self._done(job, answer)

    def _watch(self) -> None:
        for worker in self._workers:
            if worker.process is None or (worker.ready and worker.current is None):
                continue
            limit = self.limits.memory_bytes
            if time.monotonic() > worker.deadline:
                allowed = self.limits.job_s if worker.ready else self.limits.start_s
                self._lost(worker, f"no answer within {allowed:g} s")
            elif limit and (held := self._memory(worker)) > limit:
                self._lost(worker, f"held {held / 2**30:.2f} GiB, more than the limit of {limit / 2**30:.2f} GiB")

    def _memory(self, worker: _Worker) -> int:
        assert worker.process is not None
        try:
            return int(psutil.Process(worker.process.pid).memory_info().rss)
        except psutil.Error:
            return 0

    def _last_words(self, worker: _Worker) -> str:
        assert worker.process is not None
        code = worker.process.wait()
        how = f"ended by signal {-code}" if code < 0 else f"ended with exit code {code}"
        with worker.log.open("rb") as log:
            log.seek(worker.log_start)
            tail = log.read()[-LOG_TAIL:].decode("utf-8", "replace").strip()
        return f"Blender {how}" + (f"; its last words: {tail.splitlines()[-1]}" if tail else "")

    def _lost(self, worker: _Worker, reason: str) -> None:
        """The worker is dead or shall be: blame its job, if it has one."""
        self._kill(worker)
        self.restarts += 1
        worker.reason = reason
        self._say(f"worker {worker.number}: {reason}; it is started again")
        job, worker.current = worker.current, None
        if job is not None:
            self._attempt_failed(worker, job, reason)

    def _attempt_failed(self, worker: _Worker, job: int, reason: str) -> None:
        reasons = self._attempts.setdefault(job, [])
        reasons.append(reason)
        self._failed_in_a_row += 1
        if self._failed_in_a_row >= self.limits.give_up_after:
            raise HulldownError(
                f"{self._failed_in_a_row} attempts have failed one after the other, the last with: {reason}",
                path=worker.log,
                remedy="mend the cause and run again, which goes on from here",
            )
        if len(reasons) < self.limits.attempts:
            worker.jobs.append(job)  # at the end, so that others are not kept waiting
        else:
            self._left -= 1
            self._failed(job, reasons)

    def _stop(self, worker: _Worker) -> None:
        """Let an idle worker end by itself."""
        assert worker.process is not None
        assert worker.process.stdin is not None
        worker.process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            worker.process.wait(STOP_S)
        self._kill(worker)

    def _kill(self, worker: _Worker) -> None:
        process = worker.process
        if process is None:
            return
        process.kill()
        process.wait()
        assert worker.listener is not None
        worker.listener.join(STOP_S)
        for stream in (process.stdin, process.stdout):
            assert stream is not None
            stream.close()
        worker.process, worker.ready = None, False

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            self._kill(worker)
