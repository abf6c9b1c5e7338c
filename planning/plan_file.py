"""The plan on disk: JSON lines, a header first, then one line per image; read as a stream or by index.

A plan is written to a partial file beside its name and renamed when it is complete. A partial file whose header is the
one that would be written now is continued; every other one is replaced.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import filelock
import numpy as np
import orjson
from jaxtyping import Int

from geometry.errors import ConfigError
from geometry.files import stays_inside
from planning.row_types import misfit

FORMAT = 1
TARGET_KEYS = (
    "vehicle",
    "category",
    "world_from_vehicle",
    "articulation",
    "bbox",
    "bbox_amodal",
    "visible_fraction",
    "truncated_fraction",
    "slope_deg",
    "gap",
    "penetration",
    "tries",
)
ROW_KEYS = (
    "index",
    "image_id",
    "file_name",
    "scenery",
    "position",
    "shot",
    "world_from_camera",
    "fov_x_deg",
    "width",
    "height",
    "hdri",
    "hdri_yaw_deg",
    "strength",
    "weather",
    "sample_seed",
    *TARGET_KEYS,
    "companions",
    "rejected",
)
_CHUNK = 1 << 24
_BEGINNING = b'{"hulldown_plan":'


class Plan:
    """A plan file, opened for reading: `len(plan)`, `plan[i]`, `for row in plan`.

    Parameters
    ----------
    path
        The file.
    header
        Its first line: config, seed, assets, versions.
    """

    def __init__(self, path: Path, header: dict[str, Any]) -> None:
        self.path, self.header = path, header
        self._starts: Int[np.ndarray, " n"] | None = None

    def __len__(self) -> int:
        return int(self.header["images"])

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return self.rows()

    def rows(self, start: int = 0) -> Iterator[dict[str, Any]]:
        """Rows from index `start` on, one at a time.

        Raises
        ------
        ConfigError
            With the line's number, at the first line that is no row of this plan, or if lines are missing.
        """
        i = -1
        with self.path.open("rb") as file:
            file.readline()
            for i, line in enumerate(file):
                if i >= start:
                    yield self._row(line, i)
        if i + 1 < len(self):
            raise self._too_short(i + 1)

    def __getitem__(self, index: int) -> dict[str, Any]:
        if not 0 <= index < len(self):
            raise IndexError(f"index: expected 0 to {len(self) - 1}, got {index}")
        with self.path.open("rb") as file:
            if self._starts is None:
                self._starts = line_starts(file)
            if index + 2 >= len(self._starts):
                raise self._too_short(len(self._starts) - 2)
            file.seek(int(self._starts[index + 1]))
            return self._row(file.readline(), index)

    def _too_short(self, rows: int) -> ConfigError:
        return ConfigError(
            f"ends after {rows} of {len(self)} images", path=self.path, remedy="plan again with `hulldown plan`"
        )

    def _row(self, line: bytes, index: int) -> dict[str, Any]:
        number = index + 2  # the header is line 1
        try:
            row = orjson.loads(line)
        except orjson.JSONDecodeError as error:
            raise self._damaged(number, f"is no JSON ({error})") from None
        if not isinstance(row, dict):
            raise self._damaged(number, f"is {type(row).__name__}, not an image")
        if lacking := [key for key in ROW_KEYS if key not in row]:
            raise self._damaged(number, f"lacks {', '.join(lacking[:3])}")
        if index >= len(self):
            raise self._damaged(number, f"is more than the {len(self)} images of the header")
        if row["index"] != index:
            raise self._damaged(number, f"has index {row['index']!r}, expected {index}")
        if wrong := misfit(row):
            raise self._damaged(number, wrong)
        if row["image_id"] != index + 1:
            raise self._damaged(number, f"has image_id {row['image_id']}, expected {index + 1}")
        self._check_categories(row, number)
        if not stays_inside(row["file_name"]):
            raise self._damaged(number, f"has file_name {row['file_name']!r}, which leaves the dataset's folder")
        return row

    def _check_categories(self, row: dict[str, Any], number: int) -> None:
        """A row may not call a vehicle what the header does not call it; unknown vehicles are others' to refuse."""
        for target in (row, *row["companions"]):
            known = self.header["vehicles"].get(target["vehicle"])
            if known is not None and target["category"] != known["category"]:
                what = f"has the class {target['category']!r} for {target['vehicle']!r}, expected {known['category']!r}"
                raise self._damaged(number, what)

    def _damaged(self, number: int, what: str) -> ConfigError:
        return ConfigError(f"line {number} {what}", path=self.path, remedy="plan again with `hulldown plan`")


def read_plan(path: str | Path) -> Plan:
    """Open a plan; rows are read when asked for.

    Raises
    ------
    ConfigError
        If the file is missing, is no plan, or was written by a later version.

    Examples
    --------
    >>> plan = read_plan("plan.jsonl")
    >>> len(plan)
    22
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            line = file.readline()
    except FileNotFoundError:
        raise ConfigError("no such plan", path=path, remedy="make one with `hulldown plan`") from None
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", path=path) from None
    try:
        header = orjson.loads(line)
        version = header["hulldown_plan"]
    except (orjson.JSONDecodeError, KeyError, TypeError):
        raise ConfigError(
            "line 1 is no header of a plan", path=path, remedy="make a plan with `hulldown plan`"
        ) from None
    if version != FORMAT:
        raise ConfigError(
            f"line 1 has plan format {version!r}, this is format {FORMAT}",
            path=path,
            remedy="plan again with this version",
        )
    wanted = {
        "config": dict,
        "seed": int,
        "vehicles": dict,
        "sceneries": dict,
        "hdris": dict,
        "images": int,
        "root": str,
    }
    for key, kind in wanted.items():
        if not isinstance(header.get(key), kind):
            raise ConfigError(f"line 1 lacks {key}", path=path, remedy="plan again with `hulldown plan`")
    return Plan(path, header)


def encode(record: Mapping[str, Any]) -> bytes:
    """One line: a header or a row; floats with the fewest digits that read back exactly."""
    return orjson.dumps(record, option=orjson.OPT_APPEND_NEWLINE)


class PlanWriter:
    """Writes a plan beside its final name, from where an earlier attempt stopped, and renames it when it is complete.

    Parameters
    ----------
    path
        Final name of the plan.
    header
        Its first line.

    Attributes
    ----------
    rows
        Complete rows in the file; when it is opened, those of an earlier attempt.

    Raises
    ------
    ConfigError
        If another process is writing the same plan, the path is that of a folder or of a file that is no plan, or
        the folder cannot be written.
    """

    def __init__(self, path: str | Path, header: Mapping[str, Any]) -> None:
        self.path = Path(path)
        self.partial = self.path.with_name(self.path.name + ".partial")
        self._lock = filelock.FileLock(self.path.with_name(f".{self.path.name}.lock"), timeout=0)
        self._header = encode(header)
        _refuse_other_file(self.path)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._lock.acquire()
            self._file = self._open()
        except filelock.Timeout:
            raise ConfigError("another process is writing this plan", path=self.path, remedy="wait for it") from None
        except OSError as error:
            raise ConfigError(f"cannot be written: {error.strerror}", path=self.path) from None

    def _open(self) -> BinaryIO:
        if self.partial.exists():
            file = self.partial.open("r+b")
            if file.readline() == self._header:
                self._starts = line_starts(file)
                self.rows = len(self._starts) - 2
                return file
            file.close()
        file = self.partial.open("w+b")
        file.write(self._header)
        self._starts = np.array([0, len(self._header)])
        self.rows = 0
        return file

    def keep(self, rows: int) -> None:
        """Drop what was found after the first `rows` rows, and write from there; to be called before `write`."""
        end = int(self._starts[rows + 1])
        self._file.truncate(end)
        self._file.seek(end)
        self.rows = rows

    def write(self, lines: bytes, rows: int) -> None:
        """Append `rows` encoded rows."""
        self._file.write(lines)
        self.rows += rows

    def finish(self) -> None:
        """Make what was written the plan."""
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self.partial.replace(self.path)

    def __enter__(self) -> PlanWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        if self.rows == 0:
            self.partial.unlink(missing_ok=True)
        self._lock.release()
        Path(self._lock.lock_file).unlink(missing_ok=True)


def _refuse_other_file(path: Path) -> None:
    """A slip such as `-o` with the config's name must not cost the user that file."""
    if path.is_dir():
        raise ConfigError("is a folder", path=path, remedy="name a file for the plan, such as plan.jsonl")
    if path.is_file():
        with path.open("rb") as file:
            start = file.read(len(_BEGINNING))
        if start not in (b"", _BEGINNING):
            raise ConfigError("exists and is no plan", path=path, remedy="name another file, or delete it first")


def line_starts(file: BinaryIO) -> Int[np.ndarray, " lines_plus_1"]:
    """Where each complete line of a file begins, and where the last complete line ends."""
    file.seek(0)
    parts, at = [np.zeros(1, dtype=np.int64)], 0
    while chunk := file.read(_CHUNK):
        parts.append(np.flatnonzero(np.frombuffer(chunk, dtype=np.uint8) == 0x0A) + (at + 1))
        at += len(chunk)
    return np.concatenate(parts)
