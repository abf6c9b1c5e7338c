"""Watch the memory and the output of a child process that reads a file."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated

from cyclopts import Parameter

from hulldown.base.arguments import Positive, make_option_parser
from hulldown.base.child import Child, process_memory_limit
from hulldown.base.errors import HulldownError
from hulldown.base.terminal import print_warning
from hulldown.reading.confinement.landlock import CONFINEMENT_VARIABLE, unconfined_reason

POLL_INTERVAL_S = 0.05  # a bomb fills a gigabyte in a third of a second
GIB_BYTES = 2**30
LAST_LINES = 40
MAX_LOG_LINE_BYTES = 4096


def parse_gib_as_bytes(text: str) -> int:
    """Return bytes of a number of GiB."""
    if not 0.0 < (number := float(text)) < math.inf:
        raise ValueError(text)
    return round(number * GIB_BYTES)


GIBIBYTES_PARSER = make_option_parser("a number above 0", parse_gib_as_bytes, metavar="GIB")


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class ReadLimits:
    """Limits of reading a file.

    Parameters
    ----------
    silence_s
        Stop reading an asset after this many seconds without progress.
    memory_bytes
        Stop reading an asset above this resident memory, in GiB on the command line; by default its share of nine
        tenths of the machine's.
    require_confinement
        Refuse to read files if Blender can't be confined.
    """

    silence_s: Annotated[Positive, Parameter(name="--read-timeout")] = 900.0
    memory_bytes: Annotated[int | None, GIBIBYTES_PARSER, Parameter(name="--read-memory")] = None
    require_confinement: bool = False
    share: Annotated[int, Parameter(parse=False)] = 1  # how many files are read at a time, which share the memory

    @property
    def memory(self) -> float:
        """Bytes of memory that one process may use."""
        return process_memory_limit(self.memory_bytes, self.share)

    def refuse_or_warn_unconfined(self) -> None:
        """Refuse to continue unconfined, or warn once per process."""
        if (why := unconfined_reason()) and self.require_confinement:
            remedy = f"use Linux 5.13 or later without {CONFINEMENT_VARIABLE}=off, or leave out --require-confinement"
            raise HulldownError(f"Blender would not be confined: {why}", remedy=remedy)
        if why:
            _warn_unconfined(why)


@cache
def _warn_unconfined(why: str) -> None:
    print_warning(f"files from elsewhere are read unconfined: {why}; see docs/safety.md")


DEFAULT_LIMITS = ReadLimits()


def run_limited_command(
    command: Sequence[str], *, env: Mapping[str, str], limits: ReadLimits = DEFAULT_LIMITS
) -> tuple[int, str, str]:
    """Run `command` to its end, or until it exceeds a limit; every line that it writes counts as progress."""
    lines: deque[bytes] = deque(maxlen=LAST_LINES)
    heard = time.monotonic()

    def on_line(line: bytes) -> None:
        nonlocal heard
        lines.append(line[:MAX_LOG_LINE_BYTES])
        heard = time.monotonic()

    exceeded = ""
    with Child(command, env=env, on_line=on_line) as child:
        while child.code is None and not exceeded:
            held = child.memory
            if held > limits.memory:
                allowed = f"the limit of {limits.memory / GIB_BYTES:.2f} GiB"
                exceeded = f"reading it took {held / GIB_BYTES:.2f} GiB of memory, more than {allowed}"
            elif time.monotonic() - heard > limits.silence_s:
                exceeded = f"reading it got nowhere for {limits.silence_s:g} s, which is the limit"
            time.sleep(0 if exceeded else POLL_INTERVAL_S)
        code = child.kill()
    return code, b"".join(lines).decode("utf-8", "replace"), exceeded
