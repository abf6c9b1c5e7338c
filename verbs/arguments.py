"""Types of arguments, and arguments that several verbs share."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, TypeVar

if TYPE_CHECKING:
    pass

Subparsers: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
Value = TypeVar("Value")


def add_verb(
    verbs: Subparsers,
    name: str,
    run: Callable[[argparse.Namespace], int | None],
    does: str,
    more: str,
    *,
    resumes: bool = False,
    json: bool = True,
) -> argparse.ArgumentParser:
    """Add a verb, or a step of one, and return its parser."""
    sub = verbs.add_parser(name, help=does, description=f"{does[0].upper()}{does[1:]}. {more}")
    sub.set_defaults(run=run, resumes=resumes)
    if json:
        sub.add_argument("--json", action="store_true", help="machine-readable result on stdout")
    return sub


class Choices:
    """Names that an argument allows, found when they're needed, so that other verbs don't import the stage."""

    def __init__(self, find: Callable[[], Iterable[str]]) -> None:
        self._find = find

    def __iter__(self) -> Iterator[str]:
        return iter(self._find())


def argument(
    expected: str, convert: Callable[[str], Value], fits: Callable[[Value], bool] = lambda _: True
) -> Callable[[str], Value]:
    """Return a type for argparse that refuses text if `convert` raises ValueError, or the value doesn't fit.

    Examples
    --------
    >>> argument("an even number", int, lambda number: number % 2 == 0)("4")
    4
    """

    def parse(text: str) -> Value:
        with suppress(ValueError):
            if fits(value := convert(text)):
                return value
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")

    return parse


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split(","))


def _share(text: str) -> tuple[int, int]:
    which, of = text.split("/")
    return int(which), int(of)


def _size(text: str) -> tuple[int, int]:
    width, height = text.lower().split("x")
    return int(width), int(height)


def _named_folder(text: str) -> tuple[str, Path]:
    name, _, folder = text.partition("=")
    if not (name and folder):
        raise ValueError(text)
    return name, Path(folder)


picture_name = argument("the name of a .png file", Path, lambda path: path.suffix.lower() == ".png")
page_name = argument("the name of a .html file", Path, lambda path: path.suffix.lower() == ".html")
positive = argument("a number above 0", float, lambda number: 0.0 < number < math.inf)
at_least_zero = argument("a number from 0 on", float, lambda number: 0.0 <= number < math.inf)
fraction = argument("a number from 0 to 1", float, lambda number: 0.0 <= number <= 1.0)
overlap = argument("a number above 0 and up to 1", float, lambda number: 0.0 < number <= 1.0)
at_least_one = argument("a whole number of at least 1", int, lambda number: number >= 1)
port = argument("a port from 0 to 65535", int, lambda number: 0 <= number <= 65535)
fractions = argument("shares such as 1,0.5,0.25", _numbers)
three_shares = argument(
    "three shares that add up to 1, such as 0.7,0.2,0.1", _numbers,
    lambda shares: len(shares) == 3 and all(share >= 0 for share in shares) and abs(sum(shares) - 1.0) <= 1e-6,
)  # fmt: skip
one_of_shares = argument("K/N with K from 1 to N, such as 3/8", _share, lambda share: 1 <= share[0] <= share[1])
tile_size = argument("WxH, such as 640x480", _size, lambda size: min(size) >= 32)
named_folder = argument("NAME=DIR, such as real=photographs", _named_folder)
