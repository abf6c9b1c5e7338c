"""The command's output: results on stdout, tables, JSON, exit codes."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.markup import escape
from rich.table import Table

from hulldown.geometry.terminal import Terminal, warn

STDOUT = Terminal(highlight=False)
WIDEST = 10_000  # characters of a table in a file or a pipe
DONE, FOUND, MISTAKE, STOPPED = 0, 1, 2, 130  # exit codes


@contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Show Python's warnings like other messages, without their place in the code."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        elsewhere = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if category is UserWarning:
                warn(str(message))
            else:
                elsewhere(message, category, *where, **more)

        warnings.showwarning = show
        yield


def silence_stdout() -> None:
    """Discard buffered output, which must not fail again when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def show_list(lines: Sequence[str]) -> None:
    """Print lines on stdout, each unbroken in a narrow terminal."""
    for line in lines:
        STDOUT.print(escape(line), soft_wrap=True)


def show_table(table: Table) -> None:
    """Print a table on stdout, with its full width in a file or a pipe."""
    if STDOUT.is_terminal:
        STDOUT.print(table)
    else:
        Terminal(file=STDOUT.file, width=WIDEST, highlight=False).print(table)


def print_json(value: Any) -> None:
    """Print a result for machines on stdout."""
    sys.stdout.write(json.dumps(value, indent=2, default=str) + "\n")
    sys.stdout.flush()
