"""The journal of a dataset: one JSON line for each finished image, on disk before the call returns."""

from __future__ import annotations

import mmap
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import orjson

from hulldown.annotate.coco_types import Record
from hulldown.base.errors import DatasetError
from hulldown.base.files import atomic_writer, open_file_to_append, open_regular_file, sync_folder
from hulldown.base.outside import parse_json

MERGED_LINE = b'{"merged":true}\n'  # everything above this line is in annotations.json
JOURNAL_OPTIONS = orjson.OPT_APPEND_NEWLINE | orjson.OPT_SERIALIZE_NUMPY


class Journal:
    """An append-only file of JSON lines, on disk when `append` returns; opening drops an unfinished last line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with DatasetError.replace_os_errors("cannot be written to", path=path, remedy="put the file itself there, writable"):
            self._file = open_file_to_append(path)
        self.length = _whole_lines_length(path)
        if self.length < path.stat().st_size:
            warnings.warn(f"{path}: the last line was cut off while it was written; that one record is dropped", stacklevel=2)
            self.truncate(self.length)
        sync_folder(path.parent)

    def append(self, record: Record) -> None:
        """Write `record` as the next line; on disk when this returns."""
        self.append_bytes(orjson.dumps(record, option=JOURNAL_OPTIONS))

    def append_bytes(self, line: bytes) -> None:
        """Write one line, JSON with its newline, that the caller has serialized."""
        if self._file.closed:
            raise ValueError(f"{self.path}: expected an open journal, got a closed one")
        problem, remedy = "the finished image could not be recorded", "free some space and run the same command again"
        with DatasetError.replace_os_errors(problem, path=self.path, remedy=remedy):
            try:
                written = 0
                while written < len(line):
                    written += os.write(self._file.fileno(), line[written:])
                os.fsync(self._file.fileno())
            except OSError:
                self._file.truncate(self.length)
                raise
        self.length += len(line)

    def truncate(self, length: int) -> None:
        """Remove everything after the first `length` bytes."""
        self._file.truncate(length)
        os.fsync(self._file.fileno())
        self.length = length

    def close(self) -> None:
        """Close the file. Closing twice is harmless."""
        self._file.close()


def read_journal(path: Path) -> Iterator[Record]:
    """Yield the records of a journal in order, without an unfinished last line; none without a file."""
    if not path.exists():
        return
    with _open_journal(path) as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):
                return
            try:
                yield parse_json(line, dict[str, object])
            except ValueError as error:
                raise _damaged_line_error(path, number, str(error)) from error


def last_merged_line_number(path: Path) -> int:
    """Return the number of a journal's last `MERGED_LINE` line; 0 if there is none."""
    if not path.exists():
        return 0
    with _open_journal(path) as file:
        return max((number for number, line in enumerate(file, start=1) if line == MERGED_LINE), default=0)


@contextmanager
def open_replacement_file(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces the file at `path` in one step when it's complete."""
    remedy = "free some space and run the same command again, which goes on from here"
    with DatasetError.replace_os_errors("cannot be written", path=path, remedy=remedy), atomic_writer(path) as file:
        yield file


def lacks_newline(path: Path) -> bool:
    """Return whether a journal's last line is unfinished; false without a journal."""
    return path.exists() and _whole_lines_length(path) < path.stat().st_size


def _open_journal(path: Path) -> BinaryIO:
    with DatasetError.replace_os_errors("cannot be read", path=path, remedy="put the file itself there"):
        return open_regular_file(path)


def _whole_lines_length(path: Path) -> int:
    with _open_journal(path) as file:
        if not os.fstat(file.fileno()).st_size:
            return 0
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return content.rfind(b"\n") + 1


def _damaged_line_error(path: Path, number: int, what: str) -> DatasetError:
    return DatasetError(
        f"line {number} is damaged ({what})",
        path=path,
        remedy="restore the file from a backup, or delete that line to give its image up",
    )
