"""What the command says: results on stdout, messages and progress on stderr, and nothing that steers the terminal."""

from __future__ import annotations

import json
import os
import sys
import unicodedata
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from hulldown.geometry.errors import HulldownError


class Terminal(Console):
    """Where the command writes to; what is written cannot steer it."""

    def render(self, renderable: Any, options: Any = None) -> Iterator[Segment]:
        """As Rich does, but names from other people's files cannot steer the terminal."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)

    def on_broken_pipe(self) -> None:
        """Leave it to `main`: Rich would end the process with exit code 1, as if something had been found."""
        raise BrokenPipeError


STDERR = Terminal(stderr=True, highlight=False)
STDOUT = Terminal(highlight=False)
WIDEST = 10_000  # characters of a table in a file or a pipe
LONGEST_LINE = 2000  # characters of a message
SPEED_S = 300.0  # over which the speed of a bar is taken
DONE, FOUND, MISTAKE, STOPPED = 0, 1, 2, 130  # exit codes


def printable(text: str) -> str:
    r"""The text with what would steer a terminal written out: escape codes, returns, changes of direction.

    Examples
    --------
    >>> print(printable("tank" + chr(27) + "[2J" + chr(0x202E)))
    tank\x1b[2J\u202e
    """
    if text.isprintable():
        return text
    return "".join(c if c == "\n" or not unicodedata.category(c).startswith("C") else _written_out(c) for c in text)


def _written_out(char: str) -> str:
    return char.encode("unicode_escape").decode("ascii")


def in_one_line(message: str) -> str:
    """A message without line breaks of the names in it, and with its middle left out where it fills a screen."""
    line = " ".join(message.splitlines())
    return line if len(line) <= LONGEST_LINE else f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"


@contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """What a stage warns the user of is shown as everything else is, without a place in the code."""
    with warnings.catch_warnings():
        elsewhere = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if category is UserWarning:
                warn(str(message))
            else:
                elsewhere(message, category, *where, **more)

        warnings.showwarning = show
        yield


def silence_stdout() -> None:
    """What is still buffered must not fail again when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def make_room(path: Path) -> None:
    """Make the folder of a file that shall be written, before the long work, or refuse."""
    if path.is_dir():
        raise HulldownError("is a folder", path=path, remedy="name a file in it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise HulldownError(
            f"cannot be written ({error.strerror})", path=path, remedy="choose a folder that you may write to"
        ) from None


def make_room_for_picture(path: Path) -> None:
    """As `make_room`, and refuse to replace what is no picture of ours."""
    from hulldown.annotate.sheets import refuse_foreign

    make_room(path)
    refuse_foreign(path)


def show_list(lines: Sequence[str]) -> None:
    """On stdout, a line each however narrow the terminal."""
    for line in lines:
        STDOUT.print(escape(line), soft_wrap=True)


def show_table(table: Table) -> None:
    """On stdout; as wide as it is where no terminal limits it, since whoever reads it there wants whole names."""
    if STDOUT.is_terminal:
        STDOUT.print(table)
    else:
        Terminal(file=STDOUT.file, width=WIDEST, highlight=False).print(table)


def say(line: str) -> None:
    """Tell the user something on stderr."""
    STDERR.print(escape(line), soft_wrap=True)


def warn(line: str) -> None:
    """Tell the user on stderr what deserves a look."""
    STDERR.print(f"[yellow]warning:[/] {escape(line)}", soft_wrap=True)


def print_json(value: Any) -> None:
    """Print a result for machines on stdout."""
    sys.stdout.write(json.dumps(value, indent=2, default=str) + "\n")
    sys.stdout.flush()


@contextmanager
def reading_status() -> Iterator[Callable[[str], None]]:
    """A sign of life on stderr; yields what is to be called with the path that is read."""
    with STDERR.status("reading assets") as status:
        yield lambda path: status.update(f"reading {escape(path)}")


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr; yields what is to be called with the steps done and their total."""
    with titled_bar() as advance:
        yield lambda done, total: advance(title, done, total)


@contextmanager
def titled_bar(*, unit: str = "") -> Iterator[Callable[[str, int, int], None]]:
    """A bar on stderr; yields what is to be called with its title, the steps done and their total.

    Parameters
    ----------
    unit
        What the steps are, to show how many a second there are; empty for not.
    """
    speed = [Speed(unit)] if unit else []
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *speed, TimeElapsedColumn(),
        TimeRemainingColumn(),
    )  # fmt: skip
    bar = Progress(*columns, console=STDERR, speed_estimate_period=SPEED_S)
    task = bar.add_task("", total=None)

    def advance(title: str, done: int, total: int) -> None:
        bar.start()
        bar.update(task, description=title, completed=done, total=total)

    try:
        yield advance
    finally:
        # A bar that never started has nothing to say: a mistake stays one line.
        if bar.live.is_started:
            bar.stop()


class Speed(ProgressColumn):
    """Steps a second, lately.

    Parameters
    ----------
    unit
        What the steps are.
    """

    def __init__(self, unit: str) -> None:
        super().__init__()
        self._unit = unit

    def render(self, task: Task) -> Text:
        """As Rich asks for it."""
        return Text(f"{task.speed:.3g} {self._unit}/s" if task.speed else "", style="progress.data.speed")


@contextmanager
def progress_bars() -> Iterator[Callable[[str, int, int], None]]:
    """Bars on stderr, one after the other; yields what is to be called with a title, the steps done, their total."""
    with ExitStack() as bars:
        advance: dict[str, Callable[[int, int], None]] = {}

        def show(title: str, done: int, total: int) -> None:
            if title not in advance:
                bars.close()
                advance[title] = bars.enter_context(progress_bar(title))
            advance[title](done, total)

        yield show
