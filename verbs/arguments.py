"""What arguments of the command may be, and those that several verbs share."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, runtime_checkable

from geometry.errors import HulldownError
from reading.landlock import OFF, unconfined
from reading.watch import GIB, ReadLimits
from verbs.terminal import warn


@runtime_checkable
class AddVerb(Protocol):
    """Adds a verb to the command."""

    def __call__(
        self, name: str, run: Callable[[argparse.Namespace], int], does: str, more: str, *, resumes: bool = False
    ) -> argparse.ArgumentParser:
        """Its parser; `resumes` says that the same command goes on with what was stopped."""
        ...


def picture_name(text: str) -> Path:
    """The name of a .png file."""
    if Path(text).suffix.lower() != ".png":
        raise argparse.ArgumentTypeError(f"expected the name of a .png file, got {text!r}")
    return Path(text)


def page_name(text: str) -> Path:
    """The name of a .html file."""
    if Path(text).suffix.lower() != ".html":
        raise argparse.ArgumentTypeError(f"expected the name of a .html file, got {text!r}")
    return Path(text)


def read_limits(arguments: argparse.Namespace) -> ReadLimits:
    """How much memory and time reading an asset may take; warns if Blender can't be confined.

    Raises
    ------
    HulldownError
        If the command requires confinement and there is none.
    """
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
    """What `read_limits` reads."""
    sub.add_argument(
        "--read-timeout", type=positive, metavar="SECONDS",
        help="give an asset up that has got nowhere for so long (default: 900)",
    )  # fmt: skip
    sub.add_argument(
        "--read-memory", type=positive, metavar="GIB",
        help="give an asset up that takes more memory (default: its share of nine tenths of the machine's)",
    )  # fmt: skip
    sub.add_argument(
        "--require-confinement", action="store_true", help="refuse to read files where Blender can't be confined"
    )


def positive(text: str) -> float:
    """A finite number above 0."""
    return _number(text, "a number above 0", lambda number: 0.0 < number < math.inf)


def at_least_zero(text: str) -> float:
    """A finite number from 0 on."""
    return _number(text, "a number from 0 on", lambda number: 0.0 <= number < math.inf)


def three_shares(text: str) -> tuple[float, ...]:
    """Three shares that add up to 1."""
    try:
        shares = tuple(float(word) for word in text.split(","))
    except ValueError:
        shares = ()
    # What is no number fails each comparison.
    if len(shares) != 3 or not all(share >= 0 for share in shares) or not abs(sum(shares) - 1.0) <= 1e-6:
        raise argparse.ArgumentTypeError(f"expected three shares that add up to 1, such as 0.7,0.2,0.1, got {text!r}")
    return shares


def fractions(text: str) -> tuple[float, ...]:
    """Numbers with commas between them; their range is the stage's to check."""
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected shares such as 1,0.5,0.25, got {text!r}") from None


def named_folder(text: str) -> tuple[str, Path]:
    """A name and a folder."""
    name, equals, folder = text.partition("=")
    if not (name and equals and folder):
        raise argparse.ArgumentTypeError(f"expected NAME=DIR, such as real=photographs, got {text!r}")
    return name, Path(folder)


def threshold_or_best(text: str) -> float | str:
    """A confidence, or the word best."""
    return text if text == "best" else fraction(text)


def fraction(text: str) -> float:
    """A number from 0 to 1."""
    return _number(text, "a number from 0 to 1", lambda number: 0.0 <= number <= 1.0)


def overlap(text: str) -> float:
    """A number above 0 and up to 1."""
    if (value := fraction(text)) == 0.0:
        raise argparse.ArgumentTypeError("expected an overlap above 0, got 0")
    return value


def one_of_shares(text: str) -> tuple[int, int]:
    """Which of how many shares."""
    words = text.split("/")
    if len(words) == 2 and all(word.isdecimal() for word in words) and 1 <= int(words[0]) <= int(words[1]):
        return int(words[0]), int(words[1])
    raise argparse.ArgumentTypeError(f"expected K/N with K from 1 to N, such as 3/8, got {text!r}")


def at_least_one(text: str) -> int:
    """A whole number of at least 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text!r}")
    return int(text)


def port(text: str) -> int:
    """The number of a TCP port."""
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"expected a port from 0 to 65535, got {text!r}")
    return int(text)


def add_cache(sub: argparse.ArgumentParser, where: str) -> None:
    """The folder that what is read of assets is kept in."""
    sub.add_argument("--cache", type=Path, metavar="DIR", help=f"folder of what is read of assets (default: {where})")


def add_allow_links(sub: argparse.ArgumentParser) -> None:
    """Folders that links in a dataset may lead to."""
    sub.add_argument(
        "--allow-links", type=Path, metavar="DIR", action="append", default=[],
        help="folder that pictures which are links may lead to, besides their dataset; may be repeated",
    )  # fmt: skip


def _number(text: str, expected: str, fits: Callable[[float], bool]) -> float:
    """A number that fits; what is none, or not a number, fits nothing."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not fits(number):
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")
    return number
