"""The user's mistakes. Everything else that goes wrong is a bug and stays a plain exception."""

from __future__ import annotations

from pathlib import Path


class HulldownError(Exception):
    """A mistake of the user's that one line can explain.

    Parameters
    ----------
    problem
        What was found, naming key or object.
    path
        The file it was found in, if any.
    remedy
        What to do about it, as an imperative sentence without a full stop.
    """

    def __init__(self, problem: str, *, path: Path | str | None = None, remedy: str | None = None) -> None:
        self.problem, self.path, self.remedy = problem, path, remedy
        where = f"{path}: " if path is not None else ""
        cure = f"; {remedy}" if remedy else ""
        super().__init__(f"{where}{problem}{cure}")


class AssetError(HulldownError):
    """A vehicle, scenery, HDRI or bundle that cannot be used as it is."""


class ConfigError(HulldownError):
    """A config or plan file that does not say what it must."""


class DatasetError(HulldownError):
    """A dataset folder that cannot be read or written."""
