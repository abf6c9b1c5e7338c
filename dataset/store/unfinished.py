"""Folders that are written completely or not at all."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hulldown.geometry.errors import DatasetError

UNFINISHED_NAME = ".unfinished"


@contextmanager
def all_or_nothing(out: Path) -> Iterator[Path]:
    """Yield a temporary folder whose content moves to `out` at the end of the block.

    It's inside `out`, so that moving is renaming. Training tools don't see the remains of a killed run, and the
    next run replaces them.

    Raises
    ------
    DatasetError
        If `out` is a file, isn't empty, or cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(path.name != UNFINISHED_NAME for path in out.iterdir())):
        raise DatasetError("isn't empty", path=out, remedy="name an empty or a new folder")
    unfinished = out / UNFINISHED_NAME
    made = not out.exists()
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        yield unfinished
        for path in sorted(unfinished.iterdir()):
            path.rename(out / path.name)
        unfinished.rmdir()
    except BaseException as error:
        shutil.rmtree(out if made else unfinished, ignore_errors=True)
        if isinstance(error, OSError):
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            remedy = (
                "free some space and run the same command again" if full else "choose a folder that you may write to"
            )
            raise DatasetError(f"cannot be written ({error.strerror})", path=out, remedy=remedy) from error
        raise
