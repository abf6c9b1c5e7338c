"""Watch the memory and the output of a child process that reads a file."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hulldown.base.child import Child, memory_limit

POLL_S = 0.05  # a bomb fills a gigabyte in a third of a second
GIB = 2**30
LAST_LINES = 40
LONGEST_LINE = 4096  # bytes


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """Limits of reading a file."""

    silence_s: float = 900.0  # seconds since its last sign of life
    memory_bytes: int | None = None  # resident memory; None for nine tenths of the machine's
    share: int = 1  # how many files are read at a time, which share the machine's memory

    @property
    def memory(self) -> float:
        """Bytes that one process may hold."""
        return memory_limit(self.memory_bytes, self.share)


DEFAULT_LIMITS = ReadLimits()


def watched(
    command: Sequence[str], *, env: Mapping[str, str], limits: ReadLimits = DEFAULT_LIMITS
) -> tuple[int, str, str]:
    """Run `command` to its end, or until it exceeds a limit; every line that it writes is a sign of life."""
    lines: deque[bytes] = deque(maxlen=LAST_LINES)
    heard = time.monotonic()

    def on_line(line: bytes) -> None:
        nonlocal heard
        lines.append(line[:LONGEST_LINE])
        heard = time.monotonic()

    exceeded = ""
    with Child(command, env=env, on_line=on_line) as child:
        while child.code is None and not exceeded:
            held = child.memory
            if held > limits.memory:
                allowed = f"the limit of {limits.memory / GIB:.2f} GiB"
                exceeded = f"reading it took {held / GIB:.2f} GiB of memory, more than {allowed}"
            elif time.monotonic() - heard > limits.silence_s:
                exceeded = f"reading it got nowhere for {limits.silence_s:g} s, which is the limit"
            time.sleep(0 if exceeded else POLL_S)
        code = child.kill()
    return code, b"".join(lines).decode("utf-8", "replace"), exceeded
