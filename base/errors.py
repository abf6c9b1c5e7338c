"""Errors that the user can fix. Everything else is a bug and stays a plain exception."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MAX_MESSAGE_CHARACTERS = 1000  # longer problems and paths are shortened


class HulldownError(Exception):
    """A mistake in a file or setting, explained in one line.

    Parameters
    ----------
    problem
        What was found, naming key or object.
    path
        The file it was found in, if any.
    remedy
        What to do about it, as an imperative sentence without a full stop.

    Examples
    --------
    >>> print(HulldownError("no such plan", path="plan.jsonl", remedy="make one with `hulldown plan`"))
    plan.jsonl: no such plan; make one with `hulldown plan`
    """

    def __init__(self, problem: str, *, path: Path | str | None = None, remedy: str | None = None) -> None:
        problem = shorten_text(problem)
        self.problem, self.path, self.remedy = problem, path, remedy
        where = f"{shorten_text(str(path))}: " if path is not None else ""
        cure = f"; {remedy}" if remedy else ""
        super().__init__(f"{where}{problem}{cure}")

    @classmethod
    @contextmanager
    def replace_os_errors(cls, problem: str, *, path: Path | str, remedy: str | None = None) -> Iterator[None]:
        """Raise this error, with the system's reason, in place of an OSError."""
        try:
            yield
        except OSError as error:
            raise cls(f"{problem} ({error.strerror})", path=path, remedy=remedy) from error


def shorten_text(text: str, longest: int = MAX_MESSAGE_CHARACTERS) -> str:
    """Return text as one line of limited length: names in files may contain line breaks, or a megabyte."""
    text = " ".join(text.splitlines())
    return text if len(text) <= longest else f"{text[: longest // 2]} ... {text[-longest // 2 :]}"


class AssetError(HulldownError):
    """An unusable vehicle, scenery, HDRI, or bundle."""


class ConfigError(HulldownError):
    """An invalid config or plan file."""


class DatasetError(HulldownError):
    """A dataset folder that can't be read or written."""


def short_repr(value: object) -> str:
    """Return the beginning of a value from a user's file."""
    try:
        return f"{value!r:.60}"
    except ValueError:  # Python writes no integers of 5,000 digits
        return "an integer of thousands of digits"
