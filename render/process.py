"""A supervised Blender that does one job after the other, restarted if it crashes, hangs, or uses too much memory."""

from __future__ import annotations

import contextlib
import os
import pickle
import platform
import queue
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import psutil
from cyclopts import Parameter
from PIL.PngImagePlugin import PngImageFile

from hulldown.base.arguments import Positive
from hulldown.base.child import Child, Stopped, process_memory_limit
from hulldown.base.errors import HulldownError
from hulldown.base.outside import MAX_DATA_BYTES, parse_json, read_file
from hulldown.reading.confinement import landlock
from hulldown.render.blender.messages import BlendJob, Job, OutputJob, RenderJob, StartJob
from hulldown.render.blender.reply import REPLY_PREFIX, Reply

WORKER_SCRIPT = Path(__file__).with_name("blender") / "worker.py"
MAX_STOP_S = 5.0  # for a worker to end by itself
# For glibc: from how many bytes on a block goes back to the system when it is freed. This is its own first value; left
# alone it raises it to the largest block yet, and other HDRIs and vehicles leave holes: 100 MB more, 7 % growth.
# For OpenBLAS, whose threads busy-wait for products that are too small for them.
# For OpenColorIO, which otherwise keeps a processor of 3 MB for every exposure that it has ever seen.
WORKER_ENVIRONMENT = {"MALLOC_MMAP_THRESHOLD_": str(2**17), "OPENBLAS_NUM_THREADS": "1", "OCIO_DISABLE_PROCESSOR_CACHES": "1"}
CHECK_INTERVAL_S = 0.2  # of time and memory
REPLACE_MEMORY_SHARE = 0.8  # of the memory limit: above it, Blender is replaced between two jobs
GIB_BYTES = 2**30
GPU_DEVICES = ("nvidia*", "dri", "kfd", "shm")  # in /dev
DRIVER_CACHES = (".nv", ".cache/cycles", ".cache/nvidia", ".cache/neo_compiler_cache", ".cache/mesa_shader_cache")
MAX_ATTEMPTS = 3  # at a job, or at a start
MAX_START_S = 300.0
FIRST_JOBS = 5  # they set the time limit of the others
MAX_FIRST_JOB_S = 3600.0
MAX_TIME_RATIO = 20.0  # the others' time limit over the longest first job's time
MIN_TIME_LIMIT_S = 300.0  # for loading another scenery
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_NOTE_CHUNKS = (b"tEXt", b"zTXt", b"iTXt", b"eXIf", b"tIME")


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a Blender.

    Parameters
    ----------
    job_s
        Time limit of a picture in seconds; by default 20 times the longest of the first five.
    memory_bytes
        Resident memory of one Blender; by default its share of nine tenths of the machine's. A Blender that ends a
        picture above four fifths of it is replaced.
    """

    job_s: Annotated[Positive | None, Parameter(name="--image-timeout")] = None
    memory_bytes: Annotated[int | None, Parameter(parse=False)] = None


class Allowance:
    """The share of a machine's resources that each of several Blenders gets."""

    def __init__(self, limits: Limits, blenders: int = 1) -> None:
        self.limits, self.blenders = limits, blenders
        self.took: list[float] = []  # seconds of the jobs that are done

    @property
    def job_time_limit_s(self) -> float:
        """Time limit of the next job in seconds."""
        if self.limits.job_s is not None:
            return self.limits.job_s
        first = self.took[:FIRST_JOBS]
        return max(MIN_TIME_LIMIT_S, MAX_TIME_RATIO * max(first)) if len(first) == FIRST_JOBS else MAX_FIRST_JOB_S

    @property
    def memory(self) -> float:
        """Bytes of memory for each Blender."""
        return process_memory_limit(self.limits.memory_bytes, self.blenders)

    @property
    def threads(self) -> int:
        """CPU threads for each Blender; 0: all."""
        return 0 if self.blenders == 1 else max(1, (psutil.cpu_count() or 1) // self.blenders)


class AttemptFailed(Exception):
    """Raised when an attempt at a job fails, with a reason for the user."""


class Lost(AttemptFailed):
    """Raised when Blender has failed and must be restarted."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a job gave: its output, or why it failed, and what did it."""

    seconds: Mapping[str, float] = field(default_factory=dict)  # CPU seconds of each part of a picture, as in `Reply`
    content: bytes = b""  # contents of the job's output file
    reasons: tuple[str, ...] = ()  # reason of each failed attempt, if all failed
    restarts: int = 0
    # what did the job: `blender`, `devices`, `systems`, and `confinement`, as in a dataset's provenance
    made_by: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Confinement:
    """The paths that a worker may use, if the kernel has Landlock; see `reading.confinement.landlock`."""

    write: Path  # folder for output, which must exist at the start
    read: tuple[Path, ...]  # files and folders of its jobs

    def wrap_command(self, command: Sequence[str], *, gpu: bool) -> list[str]:
        """Return a command that runs `command` confined; `gpu`: with graphics cards, and their kernel caches."""
        program = shutil.which(command[0]) or command[0]
        cards = [str(card) for pattern in GPU_DEVICES for card in sorted(Path("/dev").glob(pattern))] if gpu else []
        caches = [Path.home() / cache for cache in DRIVER_CACHES] if gpu else []
        return landlock.confine_command([program, *command[1:]], read=self.read, write=[self.write, *caches], devices=cards)


class Blender:
    """A Blender that starts with its first job and stays open; confined or not. Leaving it as a context ends it."""

    def __init__(
        self,
        log: Path,
        *,
        program: str | None = None,
        device: str = "auto",
        number: int = 0,
        allowance: Allowance | None = None,
        confinement: Confinement | None = None,
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        self.devices = 1
        self._log, self._program, self._device, self._number = log, program, device, number
        self._allowance = allowance or Allowance(Limits())
        self._confinement, self._say = confinement, say
        # The doctor looks at the bpy module only.
        self._remedy = "run `hulldown doctor`" if program is None else f"see whether `{program} --background` starts"
        self._child: Child | None = None
        self._stopping: Callable[[], bool] = lambda: False
        self._restarts = 0
        self._made_by: dict[str, str] = {}

    @property
    def process_id(self) -> int | None:
        """Blender's process id; None if it isn't open."""
        return self._child.pid if self._child else None

    def do(self, job: OutputJob, *, stopping: Callable[[], bool] = lambda: False) -> Outcome:
        """Do a job, with several attempts; return when it's done or has finally failed."""
        self._stopping, self._restarts = stopping, 0
        reasons: list[str] = []
        try:
            while len(reasons) < MAX_ATTEMPTS:
                self.start_process()
                try:
                    reply, content = self._attempt_job(job)
                    return Outcome(reply.seconds, content, restarts=self._restarts, made_by=self._made_by)
                except Lost as lost:
                    self._close_lost_process(lost)
                    reasons.append(str(lost))
                except AttemptFailed as failure:
                    self._say(str(failure))
                    reasons.append(str(failure))
        except BaseException:
            self.close()
            raise
        return Outcome(reasons=tuple(reasons), restarts=self._restarts, made_by=self._made_by)

    def _attempt_job(self, job: OutputJob) -> tuple[Reply, bytes]:
        began = time.monotonic()
        reply = self._send_and_await_reply(job, self._allowance.job_time_limit_s)
        self._allowance.took.append(time.monotonic() - began)
        if reply.failed:
            raise AttemptFailed(reply.failed)
        content = _output_content(job)
        assert self._child is not None
        if self._child.memory > REPLACE_MEMORY_SHARE * self._allowance.memory:
            self._say("has grown near its memory limit and is replaced")
            self._child.close_stdin()
            self._child.wait(MAX_STOP_S)
            self.close()
        return reply, content

    def start_process(self) -> None:
        """Start Blender if necessary, and choose the device."""
        if self._child is not None:
            return
        for attempt in range(1, MAX_ATTEMPTS + 1):
            try:
                self._launch_process()
                version = self._next_reply(MAX_START_S).ready
                reply = self._send_and_await_reply(StartJob(self._device, self._number, self._allowance.threads), MAX_START_S)
            except Lost as lost:
                self._close_lost_process(lost)
                if attempt < MAX_ATTEMPTS:
                    continue
                problem = f"Blender has not started {attempt} times running: {lost}"
                raise HulldownError(problem, path=self._log, remedy=self._remedy) from None
            if reply.failed:
                raise HulldownError(f"Blender cannot be used: {reply.failed}", remedy=self._remedy)
            self.devices = reply.devices
            self._made_by = {
                "blender": version,
                "devices": reply.device,
                "systems": platform.platform(terse=True),
                "confinement": landlock.describe_confinement(),
            }
            self._say(f"renders on {reply.device}")
            return

    def _launch_process(self) -> None:
        self._log.parent.mkdir(parents=True, exist_ok=True)
        if self._log.is_symlink():
            self._log.unlink()
        self._replies: queue.SimpleQueue[Reply | None] = queue.SimpleQueue()
        replies = self._replies  # replies of a killed process are ignored

        def on_line(line: bytes) -> None:
            text = line.decode("utf-8", "replace")
            if not line:
                replies.put(None)
            elif text.startswith(REPLY_PREFIX):
                with contextlib.suppress(ValueError):  # a killed worker's partial line
                    replies.put(parse_json(line[len(REPLY_PREFIX) :], Reply))

        command = worker_command(self._program)
        more = {"TMPDIR": str(self._confinement.write)} if self._confinement else {}
        try:
            self._child = Child(
                self._confinement.wrap_command(command, gpu=self._device != "cpu") if self._confinement else command,
                env={**WORKER_ENVIRONMENT, **os.environ, **more},
                on_line=on_line,
                log=self._log,
            )
        except OSError as error:
            raise HulldownError(f"cannot be started: {error.strerror}", path=command[0]) from None

    def _send_and_await_reply(self, job: Job, seconds: float) -> Reply:
        assert self._child is not None
        self._child.write(pickle.dumps(job))
        return self._next_reply(seconds)

    def _next_reply(self, seconds: float) -> Reply:
        assert self._child is not None
        end = time.monotonic() + seconds
        while True:
            if self._stopping():
                raise Stopped
            try:
                reply = self._replies.get(timeout=CHECK_INTERVAL_S)
            except queue.Empty:
                limit = self._allowance.memory
                if time.monotonic() > end:
                    raise Lost(f"no answer within {seconds:g} s") from None
                if (held := self._child.memory) > limit:
                    over = f"held {held / GIB_BYTES:.2f} GiB, more than the limit of {limit / GIB_BYTES:.2f} GiB"
                    raise Lost(over) from None
                continue
            if reply is None:
                raise Lost(f"Blender {self._child.describe_end()}")
            if reply.unusable:
                raise HulldownError(f"Blender cannot be used: {reply.unusable}", remedy=reply.remedy)
            return reply

    def _close_lost_process(self, lost: Lost) -> None:
        self.close()
        self._restarts += 1
        self._say(f"{lost}; it is started again")

    def close(self) -> None:
        """Kill Blender; the next job starts another."""
        if self._child is not None:
            self._child.kill()
        self._child = None

    def __enter__(self) -> Blender:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def worker_command(program: str | None) -> list[str]:
    """Return the command of a worker, in this Python with the bpy module, or in an installed Blender."""
    if program is None:
        return [sys.executable, "-P", str(WORKER_SCRIPT)]
    options = ["--background", "--factory-startup", "--disable-autoexec", "--python-exit-code", "1"]
    return [program, *options, "--python", str(WORKER_SCRIPT)]


def _output_content(job: OutputJob) -> bytes:
    """Return the contents of a job's output file; not of a scene, which may have gigabytes."""
    if isinstance(job, BlendJob):
        return b""
    output = Path(job.output)
    if isinstance(job, RenderJob):
        size = job.camera.intrinsics
        if wrong := picture_damage(output, size.width, size.height):
            raise AttemptFailed(wrong)
    return read_file(output, lambda problem: AttemptFailed(f"what Blender wrote {problem}"), most=MAX_DATA_BYTES)


def png_without_notes(data: bytes) -> bytes:
    """Remove text, date, and EXIF chunks (PNG, section 5), so that equal pictures are equal files."""
    if not data.startswith(PNG_SIGNATURE):
        raise ValueError("data: expected a PNG file, got something else")
    kept, at = [PNG_SIGNATURE], len(PNG_SIGNATURE)
    while at < len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4])
        if end > len(data):
            raise ValueError("data: expected a whole PNG file, got one that ends in the middle")
        if data[at + 4 : at + 8] not in PNG_NOTE_CHUNKS:
            kept.append(data[at:end])
        at = end
    return b"".join(kept)


def picture_damage(picture: Path, width: int, height: int) -> str | None:
    """Describe the damage in a picture by Blender; None if there is none."""
    try:
        # Not by `Image.open`, which refuses pictures above a size.
        with PngImageFile(picture) as image:
            if image.size != (width, height):
                return f"Blender wrote a picture of {image.size}, expected {(width, height)}"
            image.verify()
    except (OSError, SyntaxError, ValueError) as error:
        return f"Blender wrote a picture that cannot be read ({error})"
    return None
