"""Atomic writes of files and folders, safe opens, and paths that stay inside their folder."""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import BinaryIO, TypeGuard, cast

from hulldown.base.errors import DatasetError, HulldownError

DONE_NAME = ".hulldown-done"  # of a file with the key of what made its folder
UNFINISHED_NAME = ".unfinished"  # of a folder in a dataset or an export, so that renaming its content never copies


@contextmanager
def atomic_writer(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces `path` in one step when all of it is on disk."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.unlink(missing_ok=True)  # writing would follow a link
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
        sync_folder(path.parent)
    except OSError as error:
        # A full disk does not say which file it has no room for.
        if error.errno is not None and error.filename is None:
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def replace_file(path: Path, content: bytes | memoryview) -> None:
    """Write a whole file as `atomic_writer` does."""
    with atomic_writer(path) as file:
        file.write(content)


@contextmanager
def all_or_nothing(out: Path, key: str = "") -> Iterator[Path]:
    """Yield a temporary folder whose content moves to `out` at the end of the block.

    It's inside `out`, so that moving is renaming. Training tools don't see the remains of a killed run, and the
    next run replaces them. With a key of what is made, `is_done` tells whether an earlier run with it made all.
    """
    if out.exists() and (not out.is_dir() or any(path.name != UNFINISHED_NAME for path in out.iterdir())):
        raise DatasetError("isn't empty", path=out, remedy="name an empty or a new folder")
    unfinished = out / UNFINISHED_NAME
    made = not out.exists()
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        yield unfinished
        if key:
            replace_file(unfinished / DONE_NAME, key.encode())
        _move_folder(unfinished, out)
    except BaseException as error:
        shutil.rmtree(out if made else unfinished, ignore_errors=True)
        if isinstance(error, OSError):
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            remedy = (
                "free some space and run the same command again" if full else "choose a folder that you may write to"
            )
            raise DatasetError(f"cannot be written ({error.strerror})", path=out, remedy=remedy) from error
        raise


def is_done(out: Path, key: str) -> bool:
    """Tell whether a run of `all_or_nothing` with this key ended, finishing one that was stopped as it moved files."""
    for folder in (out, out / UNFINISHED_NAME):
        with suppress(OSError), open_regular(folder / DONE_NAME) as file:
            if file.read(len(key) + 1) == key.encode():
                if (out / UNFINISHED_NAME).exists():
                    _move_folder(out / UNFINISHED_NAME, out)
                return True
    return False


def _move_folder(unfinished: Path, out: Path) -> None:
    for path in sorted(unfinished.iterdir(), key=lambda path: path.name == DONE_NAME):  # the mark last
        path.rename(out / path.name)
    unfinished.rmdir()


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading bytes; pipes and devices, which may never end, are refused."""
    # Without O_NONBLOCK, opening a pipe waits for a writer.
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    return _check_regular(descriptor, "rb", path)


def _check_regular(descriptor: int, mode: str, path: Path) -> BinaryIO:
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it isn't a regular file", str(path))
    return cast(BinaryIO, os.fdopen(descriptor, mode))


def open_in_place(path: Path) -> BinaryIO:
    """Open a file to read and append to in place, created if missing, without following a link."""
    if path.is_symlink():
        raise OSError(errno.ELOOP, "it is a link, which could lead anywhere; delete it", str(path))
    flags = os.O_RDWR | os.O_CREAT | os.O_APPEND
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"):  # whichever the system has
        flags |= getattr(os, name, 0)
    return _check_regular(os.open(path, flags, 0o666), "a+b", path)


def sync_folder(folder: Path) -> None:
    """Flush names created or renamed in `folder` to disk, where the system can."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def stays_inside(file_name: object) -> TypeGuard[str]:
    """Return whether a relative path does not leave its folder, read the Unix way and the Windows way."""
    if not isinstance(file_name, str) or not file_name or "\0" in file_name:
        return False
    unix, windows = PurePosixPath(file_name), PureWindowsPath(file_name)
    return not (unix.is_absolute() or windows.drive or windows.root or ".." in unix.parts or ".." in windows.parts)


def prepare_output_file(path: Path) -> None:
    """Make a file's folder before the long work that writes the file."""
    if path.is_dir():
        raise HulldownError("is a folder", path=path, remedy="name a file in it")
    with HulldownError.raise_for_system("cannot be written", path=path, remedy="choose a folder that you may write to"):
        path.parent.mkdir(parents=True, exist_ok=True)
