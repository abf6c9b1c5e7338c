"""The command's output: results on stdout, tables, JSON, exit codes."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
from rich.markup import escape
from rich.table import Table

from hulldown.base.terminal import Terminal, print_warning

STDOUT_TERMINAL = Terminal(highlight=False)
MAX_TABLE_WIDTH = 10_000  # characters, in a file or a pipe
STDOUT_NAME = "stdout"  # in errors
DONE, FOUND, MISTAKE, STOPPED = 0, 1, 2, 130  # exit codes


@contextmanager
def show_one_line_warnings() -> Iterator[None]:
    """Show Python's warnings like other messages, without their place in the code."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        elsewhere = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if category is UserWarning:
                print_warning(str(message))
            else:
                elsewhere(message, category, *where, **more)

        warnings.showwarning = show
        yield


def silence_stdout() -> None:
    """Discard buffered output, which would fail again when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _name_stdout_in_errors() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        error.filename = error.filename or STDOUT_NAME
        raise


@_name_stdout_in_errors()
def print_lines_and_tables(*results: str | Table) -> None:
    """Print lines and tables on stdout: lines aren't broken in a narrow terminal, nor tables in a file or pipe."""
    for result in results:
        if isinstance(result, str):
            STDOUT_TERMINAL.print(escape(result), soft_wrap=True)
        elif STDOUT_TERMINAL.is_terminal:
            STDOUT_TERMINAL.print(result)
        else:
            Terminal(file=STDOUT_TERMINAL.file, width=MAX_TABLE_WIDTH, highlight=False).print(result)


@_name_stdout_in_errors()
def print_json(result: object) -> None:
    """Print a result on stdout as JSON."""
    sys.stdout.write(json.dumps(result, indent=2, default=_value_for_json) + "\n")
    sys.stdout.flush()


def _value_for_json(value: object) -> object:
    if isinstance(value, msgspec.Struct):
        return msgspec.to_builtins(value)
    return dataclasses.asdict(value) if dataclasses.is_dataclass(value) and not isinstance(value, type) else str(value)
