"""Pictures given their names in a dataset, in one step and never outside its folder."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from annotate.journal import sync_folder
from geometry.errors import DatasetError

PLACING_SUFFIX = ".joining"  # of a picture that is about to get its name


def check_confined(folder: Path, names: Iterable[str]) -> None:
    """Refuse file names that a symbolic link would lead out of the dataset.

    Raises
    ------
    DatasetError
        Naming the first.
    """
    for parent in sorted({(folder / name).parent for name in names}):
        if not parent.resolve().is_relative_to(folder.resolve()):
            raise DatasetError("leads out of the dataset", path=parent, remedy="replace the link by a folder")


def place(picture: Path, folder: Path, name: str) -> None:
    """Give a picture that lies elsewhere a name in a dataset too: as a hard link, or as a copy where there are none.

    Parameters
    ----------
    picture
        The picture; it stays where it is.
    folder, name
        The dataset, and the name in it, which `check_confined` has passed; what has that name is replaced.

    Raises
    ------
    DatasetError
        If it cannot be written.
    """
    final = folder / name
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        if final.exists() and final.samefile(picture):
            return
        temporary = final.with_name(f".{final.name}{PLACING_SUFFIX}")
        temporary.unlink(missing_ok=True)
        _link_or_copy(picture.resolve(), temporary)
        os.replace(temporary, final)
        sync_folder(final.parent)
    except OSError as error:
        raise DatasetError(
            f"{name} cannot be written ({error.strerror})",
            path=folder,
            remedy="make room and join again, which goes on from here",
        ) from error


def _link_or_copy(source: Path, target: Path) -> None:
    with contextlib.suppress(OSError):  # another disk, or one that has no links
        os.link(source, target)
        return
    shutil.copyfile(source, target)
    with target.open("rb") as file:
        os.fsync(file.fileno())
