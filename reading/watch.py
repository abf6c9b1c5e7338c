"""A child process that reads somebody's file, watched: how much memory it holds, and whether it still writes output."""

from __future__ import annotations

import subprocess
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import psutil

POLL_S = 0.05  # a bomb fills a gigabyte in a third of a second
GIB = 2**30
LAST_LINES = 40


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """When the reading of a file is given up.

    Parameters
    ----------
    silence_s
        Seconds since its last sign of life.
    memory_bytes
        Resident memory; None for nine tenths of the machine's.
    share
        How many files are read at a time, which share the machine's memory.
    """

    silence_s: float = 900.0
    memory_bytes: int | None = None
    share: int = 1

    @property
    def memory(self) -> float:
        """Bytes that one process may hold."""
        if self.memory_bytes is not None:
            return float(self.memory_bytes)
        return 0.9 * float(psutil.virtual_memory().total) / self.share


DEFAULT_LIMITS = ReadLimits()


@dataclass(frozen=True, slots=True)
class Ended:
    """How a child process ended.

    Parameters
    ----------
    code
        Its exit code; negative for a signal.
    said
        The last that it said.
    exceeded
        Which limit it was ended for, what it had and what it might have; empty if it ended by itself.
    """

    code: int
    said: str
    exceeded: str


def watched(command: Sequence[str], *, env: Mapping[str, str], limits: ReadLimits = DEFAULT_LIMITS) -> Ended:
    """Run `command` to its end, or until it exceeds a limit; every line that it writes is a sign of life."""
    child = subprocess.Popen(
        list(command), env=dict(env), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert child.stdout is not None
    stream = child.stdout
    lines: deque[bytes] = deque(maxlen=LAST_LINES)
    heard = time.monotonic()

    def listen() -> None:
        nonlocal heard
        while line := stream.readline(4096):
            lines.append(line)
            heard = time.monotonic()

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    exceeded = ""
    try:
        while child.poll() is None and not exceeded:
            held = _memory(child.pid)
            if held > limits.memory:
                allowed = f"the limit of {limits.memory / GIB:.2f} GiB"
                exceeded = f"reading it took {held / GIB:.2f} GiB of memory, more than {allowed}"
            elif time.monotonic() - heard > limits.silence_s:
                exceeded = f"reading it got nowhere for {limits.silence_s:g} s, which is the limit"
            time.sleep(0 if exceeded else POLL_S)
    finally:
        child.kill()
        code = child.wait()
        listener.join(1.0)  # what the child has started may hold the other end
        stream.close()
    return Ended(code, b"".join(lines).decode("utf-8", "replace"), exceeded)


def _memory(pid: int) -> int:
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:  # it has just ended
        return 0
