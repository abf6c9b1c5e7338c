"""Where a verb may write: files and folders that are new, or that the same verb wrote before.

A file is known by a mark in it, a folder by a file with a known name. Inputs and other people's files are never
replaced, a folder belongs to one process at a time, and what others put into it is never deleted.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec
from filelock import FileLock, Timeout

from hulldown.base.errors import HulldownError
from hulldown.base.files import open_regular_file, replace_file
from hulldown.base.outside import file_sha256, read_json

DONE_NAME = ".hulldown-done"  # this file has the key of what made its folder, and hashes of the folder's files
LOCK_NAME = ".hulldown.lock"
UNFINISHED_NAME = ".unfinished"  # a folder inside a dataset or an export, so that renaming its content never copies
MAX_MARK_BYTES = 4096  # a file's mark is in its first bytes
OTHER_FILE = "name another file by -o, or move it away"
OTHER_FOLDER = "name a new or an empty folder by -o"
WRITABLE_REMEDY = "choose a folder that you may write to"


class OutputError(HulldownError):
    """A file or folder that may not be written."""


class OutputBusy(OutputError):
    """Another process is at work on an output."""


def require_replaceable_file(path: Path, what: str, mark: bytes = b"", *, inputs: Iterable[Path] = ()) -> None:
    """Refuse a folder, an input, and somebody's file: one that isn't empty and doesn't have the `mark`."""
    if path.is_dir():
        raise OutputError("is a folder", path=path, remedy=f"name a file for {what}")
    with OutputError.replace_os_errors("cannot be written", path=path, remedy=WRITABLE_REMEDY):
        if path.parent.is_file():
            raise NotADirectoryError(errno.ENOTDIR, f"{path.parent} is a file")
        path.parent.mkdir(parents=True, exist_ok=True)
        if not os.path.lexists(path):
            return
        if any(source.exists() and path.exists() and path.samefile(source) for source in inputs):
            raise OutputError("is an input of this command", path=path, remedy="name another file by -o")
    try:
        with open_regular_file(path) as file:
            beginning = file.read(MAX_MARK_BYTES)
        ours = not beginning or bool(mark and mark in beginning)
    except OSError:
        ours = False
    if not ours:
        raise OutputError(f"exists and isn't {what} by hulldown", path=path, remedy=OTHER_FILE)


class OutputLock:
    """The lock of an output: a file beside it, which is deleted at the end, and so are new folders that stay empty."""

    def __init__(self, path: Path, what: str, *, output: Path) -> None:
        self.path = path
        self._made = [folder for folder in path.parents if not folder.exists()]  # the inner ones first
        self._lock = FileLock(path, timeout=0)
        with OutputError.replace_os_errors("cannot be written", path=output, remedy=WRITABLE_REMEDY):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._lock.acquire()
            except Timeout:
                if not path.exists():  # where no file can be made, such as in /proc
                    raise FileNotFoundError(errno.ENOENT, "no file can be made here") from None
                remedy = "wait until it has ended, or name another output"
                raise OutputBusy(f"another process is writing this {what}", path=output, remedy=remedy) from None

    @classmethod
    def acquire_for_file(cls, path: Path, what: str) -> Self:
        """Return the lock of a file that is continued after a stop."""
        return cls(path.with_name(f".{path.name}.lock"), what, output=path)

    @property
    def is_held(self) -> bool:
        """Whether the lock hasn't been released."""
        return self._lock.is_locked

    def release(self) -> None:
        """Release the lock; releasing twice is harmless."""
        if self.is_held:
            with suppress(OSError):  # before the release, since afterwards the file may be another process's lock
                self.path.unlink()
            for folder in self._made:
                with suppress(OSError):  # it isn't empty
                    folder.rmdir()
            self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.release()


class FinishedMark(msgspec.Struct, frozen=True):
    """What a finished folder contains: the key of what made it, and the SHA-256 of each file."""

    key: str
    files: dict[str, str]


class OutputFolder(OutputLock):
    """A locked folder that a verb fills: empty but for `remains`, or with one of the files `marks`."""

    def __init__(
        self,
        path: Path,
        what: str,
        marks: Sequence[str] | None = None,
        *,
        inputs: Iterable[Path] = (),
        remains: str = LOCK_NAME,
    ) -> None:
        self.folder, own = path, f".hulldown-{what}"
        if os.path.lexists(path) and not path.is_dir():
            raise OutputError("is a file, not a folder", path=path, remedy=OTHER_FOLDER)
        for source in inputs:
            if source.is_dir() and path.resolve().is_relative_to(source.resolve()):
                raise OutputError(f"is inside {source}, which this command reads", path=path, remedy=OTHER_FOLDER)
        super().__init__(path / LOCK_NAME, what, output=path)
        names = self._content_names() - {remains}
        if names and not any(
            (home / mark).exists() for mark in ((own,) if marks is None else marks) for home in (path, self._unfinished_folder)
        ):
            self.release()
            raise OutputError(f"isn't empty: it has {min(names)} and no {what}", path=path, remedy=OTHER_FOLDER)
        for left in path.glob(".*.[0-9]*.tmp"):  # written by killed processes
            left.unlink()
        if marks is None:
            replace_file(path / own, b"")

    @property
    def _unfinished_folder(self) -> Path:
        return self.folder / UNFINISHED_NAME

    def _content_names(self) -> set[str]:
        names = {path.name for path in self.folder.iterdir()} - {LOCK_NAME, UNFINISHED_NAME}
        return {name for name in names if not (name.startswith(".") and name.endswith(".tmp"))}  # killed writers'

    @contextmanager
    def stage_content(self, key: str = "") -> Iterator[Path]:
        """Yield a folder inside the empty one; its content moves up at the end, and `finish_earlier_run` is true for `key`."""
        if names := self._content_names():
            has = "what was made of other inputs or options" if DONE_NAME in names else min(names)
            raise OutputError(f"isn't empty: it has {has}", path=self.folder, remedy=OTHER_FOLDER)
        unfinished = self._unfinished_folder
        try:
            shutil.rmtree(unfinished, ignore_errors=True)
            unfinished.mkdir()
            yield unfinished
            if key:
                replace_file(unfinished / DONE_NAME, msgspec.json.encode(FinishedMark(key, _file_hashes(unfinished))))
            self._lift_content()
        except BaseException as error:
            shutil.rmtree(unfinished, ignore_errors=True)
            if isinstance(error, OSError):
                full = error.errno in (errno.ENOSPC, errno.EDQUOT)
                remedy = "free some space and run the same command again" if full else WRITABLE_REMEDY
                problem = f"cannot be written ({error.strerror})"
                raise OutputError(problem, path=self.folder, remedy=remedy) from error
            raise

    def finish_earlier_run(self, key: str) -> bool:
        """Return whether an earlier run with this key finished; complete one that was stopped while it moved files."""
        for home in (self.folder, self._unfinished_folder):
            path = home / DONE_NAME
            with suppress(OutputError):  # damaged, or of an older version
                done = read_json(path, FinishedMark, partial(OutputError, path=path), what="a list of files")
                if done.key == key:
                    break
        else:
            return False
        if self._unfinished_folder.exists():
            self._lift_content()
        for name, digest in done.files.items():
            path = self.folder / name
            try:
                same = file_sha256(path) == digest
            except OSError:
                same = False
            if not same:
                problem = "is missing, or isn't as it was written"
                raise OutputError(problem, path=path, remedy=f"delete {self.folder}, or name another folder by -o")
        return True

    def _lift_content(self) -> None:
        new = sorted(self._unfinished_folder.iterdir(), key=lambda path: path.name == DONE_NAME)
        for path in new:
            if os.path.lexists(taken := self.folder / path.name):
                raise OutputError("was put here by somebody else", path=taken, remedy="move it away and run again")
        for path in new:
            path.rename(self.folder / path.name)
        self._unfinished_folder.rmdir()


def _file_hashes(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): file_sha256(path) for path in files}
