"""Messages and progress bars on stderr, safe from control codes in names."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.segment import Segment

Item = TypeVar("Item")
SPEED_WINDOW_S = 300.0  # a bar's speed is measured over this period


class Terminal(Console):
    """A stream for messages; control codes in them are escaped."""

    def render(self, renderable: Any, options: Any = None) -> Iterator[Segment]:
        """Render as Rich does, with control codes escaped."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(escape_controls(segment.text), segment.style)

    def on_broken_pipe(self) -> None:
        """Let `main` handle it: Rich would exit with code 1, which means findings."""
        raise BrokenPipeError


STDERR_TERMINAL = Terminal(stderr=True, highlight=False)


def escape_controls(text: str) -> str:
    r"""Escape the characters that control a terminal: escape codes, returns, direction marks.

    >>> print(escape_controls("tank" + chr(27) + "[2J" + chr(0x202E)))
    tank\x1b[2J\u202e
    """
    if text.isprintable():
        return text
    return "".join(
        c if c == "\n" or not unicodedata.category(c).startswith("C") else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


def print_message(line: str) -> None:
    """Print a message on stderr."""
    STDERR_TERMINAL.print(escape(line), soft_wrap=True)


def print_warning(line: str) -> None:
    """Print a warning on stderr."""
    STDERR_TERMINAL.print(f"[yellow]warning:[/] {escape(line)}", soft_wrap=True)


@contextmanager
def reading_status() -> Iterator[Callable[[str], None]]:
    """Show a status line on stderr; yields a function that takes the path being read."""
    with STDERR_TERMINAL.status("reading assets") as status:
        yield lambda path: status.update(f"reading {escape(path)}")


@contextmanager
def one_bar_for_all_titles(*, unit: str = "") -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on stderr; yields a function of title, steps done, and their total."""
    measured = [TextColumn("{task.fields[speed]}", style="progress.data.speed")] if unit else []
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *measured, TimeElapsedColumn(),
        TimeRemainingColumn(),
    )  # fmt: skip
    bar = Progress(*columns, console=STDERR_TERMINAL, speed_estimate_period=SPEED_WINDOW_S)
    task = bar.add_task("", total=None, speed="")

    def advance(title: str, done: int, total: int) -> None:
        bar.start()
        bar.update(task, description=title, completed=done, total=total)
        if unit and (speed := bar.tasks[task].speed):
            bar.update(task, speed=f"{speed:.3g} {unit}/s")

    try:
        yield advance
    finally:
        # A bar that never started has nothing to say: a mistake stays one line.
        if bar.live.is_started:
            bar.stop()


@contextmanager
def one_bar_per_title() -> Iterator[Callable[[str, int, int], None]]:
    """Show bars on stderr, one after the other; yields a function of title, steps done, and their total."""
    with ExitStack() as bars:
        advance: dict[str, Callable[[str, int, int], None]] = {}

        def show(title: str, done: int, total: int) -> None:
            if title not in advance:
                bars.close()
                advance[title] = bars.enter_context(one_bar_for_all_titles())
            advance[title](title, done, total)

        yield show


@contextmanager
def progress_bar(title: str, progress: Callable[[int, int], None] | None = None) -> Iterator[Callable[[int, int], None]]:
    """Yield `progress`, or if it's None a function that shows a bar in a terminal or notebook."""
    if progress is not None:
        yield progress
    elif is_interactive():
        with one_bar_for_all_titles() as advance:
            yield partial(advance, title)
    else:
        yield lambda done, total: None


def track_items(title: str, items: Iterable[Item], total: int) -> Iterator[Item]:
    """Yield items, and show a bar of those that are done in a terminal or notebook."""
    with progress_bar(title) as advance:
        for done, item in enumerate(items):
            advance(done, total)
            yield item
        advance(total, total)


def is_interactive() -> bool:
    """Return whether stderr is a terminal or a notebook."""
    return STDERR_TERMINAL.is_terminal or STDERR_TERMINAL.is_jupyter
