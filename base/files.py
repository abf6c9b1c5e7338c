"""Atomic writes of files, safe opens, and paths that stay inside their folder."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import BinaryIO, TypeGuard, cast


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
        # A full disk does not say which file it has no room for, and users don't know the temporary one.
        if error.errno is not None and error.filename in (None, str(temporary)):
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def replace_file(path: Path, content: bytes | memoryview) -> None:
    """Write a whole file as `atomic_writer` does."""
    with atomic_writer(path) as file:
        file.write(content)


def open_regular_file(path: Path) -> BinaryIO:
    """Open a regular file for reading bytes; pipes and devices, which may never end, are refused."""
    # Without O_NONBLOCK, opening a pipe waits for a writer.
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    return _open_regular_descriptor(descriptor, "rb", path)


def _open_regular_descriptor(descriptor: int, mode: str, path: Path) -> BinaryIO:
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it isn't a regular file", str(path))
    return cast(BinaryIO, os.fdopen(descriptor, mode))


def open_file_to_append(path: Path) -> BinaryIO:
    """Open a file to read and append to in place, created if missing, without following a link."""
    if path.is_symlink():
        raise OSError(errno.ELOOP, "it is a link, which could lead anywhere; delete it", str(path))
    flags = os.O_RDWR | os.O_CREAT | os.O_APPEND
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"):  # whichever the system has
        flags |= getattr(os, name, 0)
    return _open_regular_descriptor(os.open(path, flags, 0o666), "a+b", path)


def sync_folder(folder: Path) -> None:
    """Flush names created or renamed in `folder` to disk, where the system can."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_safe_relative_path(file_name: object) -> TypeGuard[str]:
    """Return whether a relative path does not leave its folder, read the Unix way and the Windows way."""
    if not isinstance(file_name, str) or not file_name or "\0" in file_name:
        return False
    unix, windows = PurePosixPath(file_name), PureWindowsPath(file_name)
    return not (unix.is_absolute() or windows.drive or windows.root or ".." in unix.parts or ".." in windows.parts)
