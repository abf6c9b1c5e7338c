"""The plan on disk as JSON lines: a header, then a line an image; a partial file with the same header is continued."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, get_type_hints, overload

import msgspec
import numpy as np
from jaxtyping import Int
from msgspec import Struct

from hulldown.base.errors import ConfigError
from hulldown.base.files import open_file_to_append, open_regular_file
from hulldown.base.outputs import OutputLock, require_replaceable_file
from hulldown.base.outside import convert_value, describe_path, parse_json
from hulldown.plan.picture_names import picture_name
from hulldown.plan.rejection import BY_KEY
from hulldown.plan.row import (
    PLAN_FORMAT,
    Header,
    PlannedVehicle,
    Row,
    decode_header,
    decode_pose,
    decode_row,
    encode_line,
    row_fields,
)

_CHUNK_BYTES = 1 << 24
PLAN_MARK = b'{"hulldown_plan":'


class PlanFile(os.PathLike[str]):
    """The rows of a plan file: `len(plan)`, `plan[i]`, `plan[:10]`, `for row in plan`; also a path."""

    def __init__(self, path: Path, header: Header) -> None:
        self.path, self.header = path, header
        self._starts: Int[np.ndarray, " n"] | None = None

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Open a plan; rows are read on access."""
        path = Path(path)
        try:
            with open_regular_file(path) as file:
                line, size = file.readline(), os.fstat(file.fileno()).st_size
        except FileNotFoundError:
            raise ConfigError("no such plan", path=path, remedy="make one with `hulldown plan`") from None
        except OSError as error:
            if not path.is_dir():
                raise ConfigError(f"cannot be read: {error.strerror}", path=path) from None
            raise _wrong_kind_error(path) from None
        try:
            version = parse_json(line, dict[str, object])["hulldown_plan"]
        except (ValueError, KeyError):
            if not line.startswith(PLAN_MARK):
                raise _wrong_kind_error(path) from None
            raise _plan_damage_error(path, 1, "isn't the header of a plan") from None
        if version != PLAN_FORMAT:
            raise _plan_damage_error(path, 1, f"has plan format {version!r:.60}, this is format {PLAN_FORMAT}")
        try:
            plan = cls(path, decode_header(line))
        except (msgspec.DecodeError, ValueError) as error:
            raise _plan_damage_error(path, 1, explain_line_damage(line, Header, error)) from None
        if len(plan) > size:  # `list(plan)` allocates memory for this number of rows
            raise _plan_damage_error(path, 1, f"has {len(plan)} images, more than the {size} bytes of the file can hold")
        return plan

    def __len__(self) -> int:
        return self.header.images

    def __iter__(self) -> Iterator[Row]:
        i, names = -1, _Names()
        with open_regular_file(self.path) as file:
            file.readline()
            for i, line in enumerate(file):
                row = self._decode_line(line, i)
                if (holder := names.register_or_find_earlier(row)) is not None:
                    problem = f"has file_name {row.file_name!r:.80}, which line {holder + 2} has"
                    raise _plan_damage_error(self.path, i + 2, problem)
                yield row
        if i + 1 < len(self):
            raise self._too_short_error(i + 1)

    @overload
    def __getitem__(self, index: int) -> Row: ...

    @overload
    def __getitem__(self, index: slice) -> list[Row]: ...

    def __getitem__(self, index: int | slice) -> Row | list[Row]:
        """Return a row, or the rows of a slice; negative indices count from the end."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(f"index: expected {-len(self)} to {len(self) - 1}, got {index}")
        index %= len(self)
        with open_regular_file(self.path) as file:
            if self._starts is None:
                self._starts = line_starts(file)
            if index + 2 >= len(self._starts):
                raise self._too_short_error(len(self._starts) - 2)
            file.seek(int(self._starts[index + 1]))
            return self._decode_line(file.readline(), index)

    def __fspath__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.path)!r}, {len(self):,} images)"

    def _too_short_error(self, rows: int) -> ConfigError:
        return ConfigError(f"ends after {rows} of {len(self)} images", path=self.path, remedy="plan again with `hulldown plan`")

    def _decode_line(self, line: bytes, index: int) -> Row:
        number = index + 2  # the header is line 1
        try:
            row = decode_row(line)
        except (msgspec.DecodeError, ValueError, RecursionError) as error:
            raise _plan_damage_error(self.path, number, explain_line_damage(line, Row, error)) from None
        if index >= len(self):
            raise _plan_damage_error(self.path, number, f"is more than the {len(self)} images of the header")
        if row.index != index:
            raise _plan_damage_error(self.path, number, f"has index {row.index}, expected {index}")
        if row.image_id != index + 1:
            raise _plan_damage_error(self.path, number, f"has image_id {row.image_id}, expected {index + 1}")
        try:
            _ = row.intrinsics
        except ValueError as error:
            raise _plan_damage_error(self.path, number, f"has no usable camera: {error}") from None
        roles = [vehicle.role for vehicle in row.planned]
        if roles[:1] != ["target"] or "target" in roles[1:] or roles[1:] != sorted(roles[1:]):
            expected = "the target, then companions, then distractors"
            raise _plan_damage_error(self.path, number, f"has planned vehicles {roles!r:.60}, expected {expected}")
        if row.target.bbox is None:
            raise _plan_damage_error(self.path, number, "has planned[0].bbox None, expected [x, y, width, height] of a target")
        if unknown := row.rejected.keys() - BY_KEY.keys():
            raise _plan_damage_error(self.path, number, f"has rejected {min(unknown)!r:.60}, which is no reason")
        for vehicle in row.planned:
            # Vehicles that the header doesn't list are refused where their assets are needed.
            source = self.header.vehicles.get(vehicle.vehicle) or self.header.distractors.get(vehicle.vehicle)
            if source is not None and vehicle.category != source.category:
                what = f"has the class {vehicle.category!r:.60} for {vehicle.vehicle!r:.60}"
                raise _plan_damage_error(self.path, number, f"{what}, expected {source.category!r:.60}")
        return row


def _wrong_kind_error(path: Path) -> ConfigError:
    remedy = "name a plan, which `hulldown plan` makes"
    return ConfigError(f"is {describe_path(path)}, not a plan", path=path, remedy=remedy)


def _plan_damage_error(path: Path, number: int, what: str) -> ConfigError:
    return ConfigError(f"line {number} {what}", path=path, remedy="plan again with `hulldown plan`")


class _Names:
    """File names of the images so far; planned names follow from the index, so only others take memory."""

    def __init__(self) -> None:
        self._others: dict[str, int] = {}  # rows of names that aren't planned
        self._rows: set[int] = set()  # the rows in `_others`

    def register_or_find_earlier(self, row: Row) -> int | None:
        """Return the earlier row with the same name, ignoring case, or None."""
        name, index = row.file_name, row.index
        if name == picture_name(index):
            return self._others.get(name)
        name = unicodedata.normalize("NFC", name).casefold()
        self._rows.add(index)
        digits = name.removeprefix("images/").removesuffix(".png")
        planned = int(digits) - 1 if digits.isascii() and digits.isdecimal() else index
        if 0 <= planned < index and planned not in self._rows and name == picture_name(planned):
            return planned
        holder = self._others.setdefault(name, index)
        return None if holder == index else holder


class PlanWriter:
    """Writes a plan to a partial file, or continues it, and renames it when it's complete."""

    def __init__(self, path: str | Path, header: Header) -> None:
        self.path = Path(path)
        self.partial = self.path.with_name(self.path.name + ".partial")
        self._header = encode_line(header)
        require_replaceable_file(self.path, "a plan", PLAN_MARK)
        self._lock = OutputLock.acquire_for_file(self.path, "plan")
        try:
            with self._explain_write_errors():
                self._file = self._open_partial()
        except BaseException:
            self._lock.release()
            raise

    def _open_partial(self) -> BinaryIO:
        file = open_file_to_append(self.partial)
        file.seek(0)
        if file.readline() == self._header:
            self._starts = line_starts(file)
            self.rows = len(self._starts) - 2
            return file
        file.truncate(0)
        file.write(self._header)
        self._starts = np.array([0, len(self._header)])
        self.rows = 0
        return file

    def keep_first_rows(self, rows: int) -> None:
        """Drop the rows after the first `rows`; call this before `write`."""
        end = int(self._starts[rows + 1])
        with self._explain_write_errors():
            self._file.truncate(end)
            self._file.seek(end)
        self.rows = rows

    def write(self, lines: bytes, rows: int) -> None:
        """Append `rows` encoded rows."""
        with self._explain_write_errors():
            self._file.write(lines)
        self.rows += rows

    def finish(self) -> None:
        """Rename the partial file to the plan."""
        with self._explain_write_errors():
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self.partial.replace(self.path)

    @contextmanager
    def _explain_write_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            problem = f"cannot be written: {error.strerror}"
            raise ConfigError(problem, path=self.path, remedy="make room and plan again, which goes on") from error

    def __enter__(self) -> PlanWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            with self._explain_write_errors():
                self._file.close()
        finally:
            if self.rows == 0:
                self.partial.unlink(missing_ok=True)
            self._lock.release()


def line_starts(file: BinaryIO) -> Int[np.ndarray, " lines_plus_1"]:
    """Return the offset of each complete line of a file, and the end of the last one."""
    file.seek(0)
    parts, at = [np.zeros(1, dtype=np.int64)], 0
    while chunk := file.read(_CHUNK_BYTES):
        parts.append(np.flatnonzero(np.frombuffer(chunk, dtype=np.uint8) == 0x0A) + (at + 1))
        at += len(chunk)
    return np.concatenate(parts)


def explain_line_damage(line: bytes, kind: type[Struct], error: Exception) -> str:
    """Explain why a line isn't a record of its kind, `Row` or `Header`, as the end of a sentence about the line."""
    try:
        record = msgspec.json.decode(line)
    except (msgspec.DecodeError, ValueError, RecursionError) as mistake:
        return f"is no JSON ({mistake})"
    if not isinstance(record, dict):
        return f"is {type(record).__name__}, not an image"
    return _first_record_problem(record, kind, "") or f"can't be used ({error})"


def _first_record_problem(record: dict[str, object], kind: type[Struct], path: str) -> str | None:
    declared, hints = row_fields(kind), get_type_hints(kind, include_extras=True)
    lacking = [name for name, field in declared.items() if name not in record and not field.optional]
    if lacking:
        return f"lacks {', '.join(path + name for name in (lacking[:1] if path else lacking[:3]))}"
    for key, field in declared.items():
        if key not in record or _converts_to_kind(value := record[key], hints[key]):
            continue
        within = value if key == "planned" and isinstance(value, list) else []
        inner = (
            _first_record_problem(each, PlannedVehicle, f"{key}[{i}].")
            for i, each in enumerate(within)
            if _converts_to_kind(each, dict)
        )
        return next(filter(None, inner), None) or f"has {path}{key} {value!r:.60}, expected {field.expected}"
    return None


def _converts_to_kind(value: object, kind: Any) -> bool:
    try:
        convert_value(value, kind, dec_hook=decode_pose)
    except (msgspec.ValidationError, ValueError, OverflowError, SystemError):  # the last two are for endless integers
        return False
    return True
