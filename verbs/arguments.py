"""Types of arguments, and arguments that several verbs share."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from hulldown.base.errors import HulldownError
from hulldown.base.terminal import reading_status, warn

if TYPE_CHECKING:
    from hulldown.planning.inputs.loading import Library
    from hulldown.planning.plan_file import Plan
    from hulldown.reading.confinement.watch import ReadLimits

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


def threshold_or_best(text: str) -> float | str:
    """Return a confidence, or the word best."""
    return text if text == "best" else fraction(text)


def read_limits(arguments: argparse.Namespace) -> ReadLimits:
    """Limits of memory and time for reading an asset; warns if Blender can't be confined."""
    from hulldown.reading.confinement.landlock import OFF, unconfined
    from hulldown.reading.confinement.watch import GIB, ReadLimits

    if why := unconfined():
        if arguments.require_confinement:
            remedy = f"use Linux 5.13 or later without {OFF}=off, or leave out --require-confinement"
            raise HulldownError(f"Blender would not be confined: {why}", remedy=remedy)
        warn(f"files from elsewhere are read unconfined: {why}; see docs/safety.md")
    memory = arguments.read_memory
    return ReadLimits(
        silence_s=arguments.read_timeout or ReadLimits().silence_s,
        memory_bytes=None if memory is None else round(memory * GIB),
    )


def add_read_limits(sub: argparse.ArgumentParser) -> None:
    """Add the arguments of `read_limits`."""
    sub.add_argument(
        "--read-timeout", type=positive, metavar="SECONDS",
        help="stop reading an asset after this time without progress (default: 900)",
    )  # fmt: skip
    sub.add_argument(
        "--read-memory", type=positive, metavar="GIB",
        help="stop reading an asset above this memory (default: its share of nine tenths of the machine's)",
    )  # fmt: skip
    sub.add_argument(
        "--require-confinement", action="store_true", help="refuse to read files if Blender can't be confined"
    )


def add_cache(sub: argparse.ArgumentParser, where: str) -> None:
    """Add the argument for the cache."""
    sub.add_argument("--cache", type=Path, metavar="DIR", help=f"cache of assets (default: {where})")


def add_planned(sub: argparse.ArgumentParser) -> None:
    """Add the arguments for reading a plan's assets."""
    add_read_limits(sub)
    add_cache(sub, ".hulldown-cache next to the plan")


def planned_library(plan: Path | Plan, arguments: argparse.Namespace) -> Library:
    """Return the assets of a plan, read by the arguments of `add_planned`."""
    from hulldown.planning.inputs.loading import load_planned_library
    from hulldown.planning.plan_file import read_plan

    with reading_status() as progress:
        limits = read_limits(arguments)
        return load_planned_library(read_plan(plan), cache=arguments.cache, progress=progress, limits=limits)


def add_allow_links(sub: argparse.ArgumentParser) -> None:
    """Add the argument for folders that links in a dataset may lead to."""
    sub.add_argument(
        "--allow-links", type=Path, metavar="DIR", action="append", default=[],
        help="folder outside of a dataset that its links may lead to; may be repeated",
    )  # fmt: skip
