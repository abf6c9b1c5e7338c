"""Place pictures in a dataset, in one step and never outside its folder."""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from hulldown.base.errors import DatasetError
from hulldown.base.files import is_safe_relative_path, sync_folder

PLACING_SUFFIX = ".joining"  # a picture has it until it's renamed


def require_path_inside(folder: Path, name: str) -> Path:
    """Return `folder / name`, which must be in the folder."""
    path = folder / name
    real = path.parent.resolve() / path.name if not path.is_dir() else path.resolve()
    if not is_safe_relative_path(name) or not real.is_relative_to(folder.resolve()):
        raise DatasetError(
            f"{name!r} leads out of the dataset, to {real}",
            path=folder,
            remedy="replace the link by a folder, or move the whole dataset there",
        )
    return path


def move_picture_to_dataset(picture: Path, folder: Path, name: str) -> None:
    """Move a finished picture to its name in the dataset, in one step and never outside the folder."""
    final = require_path_inside(folder, name)
    with explain_picture_write_errors(folder, name):
        final.parent.mkdir(parents=True, exist_ok=True)
        with picture.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(picture, final)
        sync_folder(final.parent)


def link_or_copy_picture(picture: Path, folder: Path, name: str) -> None:
    """Link or copy a picture from elsewhere into the dataset, in one step as `move_picture_to_dataset`."""
    final = require_path_inside(folder, name)
    temporary = final.with_name(f".{final.name}{PLACING_SUFFIX}")
    with explain_picture_write_errors(folder, name):
        if final.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if final.exists() and final.samefile(picture):
            return
        final.parent.mkdir(parents=True, exist_ok=True)
        temporary.unlink(missing_ok=True)
        link_or_copy_file(picture, temporary)
    move_picture_to_dataset(temporary, folder, name)


def resolve_own_picture(folder: Path, name: str, allowed: Sequence[Path] = ()) -> Path:
    """Return the file of a dataset's picture, links resolved; it must be in an allowed folder."""
    path, remedy = folder / name, "put it there or delete its record"
    try:
        real = path.resolve(strict=True)
    except FileNotFoundError:
        raise DatasetError("is missing", path=path, remedy=remedy) from None
    except (OSError, RuntimeError) as error:  # before Python 3.13, a loop of links is a RuntimeError
        reason = getattr(error, "strerror", None) or os.strerror(errno.ELOOP)
        raise DatasetError(f"cannot be read ({reason})", path=path, remedy=remedy) from None
    if not any(real.is_relative_to(home.resolve()) for home in (folder, *allowed)):
        raise DatasetError(
            f"is a link that leads out of its dataset, to {real}",
            path=path,
            remedy=f"put the picture there; if you trust it, export and join take --allow-links {real.parent}",
        )
    if not real.is_file():
        raise DatasetError("cannot be read (it isn't a regular file)", path=path, remedy=remedy)
    return real


def refuse_outside_links(folder: Path, names: Iterable[str], allowed: Sequence[Path] = ()) -> None:
    """Refuse special files, and links out of a dataset and the allowed folders; pictures may be missing."""
    root, inside = folder.resolve(), dict[str, bool]()
    for name in names:
        path = os.path.join(folder, name)
        try:
            mode = os.lstat(path).st_mode
        except OSError:
            continue
        if (home := os.path.dirname(path)) not in inside:
            inside[home] = Path(home).resolve().is_relative_to(root)
        if not (stat.S_ISREG(mode) and inside[home]):
            resolve_own_picture(folder, name, allowed)


def link_or_copy_file(source: Path, target: Path) -> None:
    """Give a file another name that doesn't exist yet, as a hard link, or as a copy if the disk has none."""
    try:
        os.link(source, target)
    except (FileNotFoundError, FileExistsError):
        raise  # copying onto an existing link would overwrite its target
    except OSError:  # another disk, or one that has no links
        shutil.copyfile(source, target)


def explain_picture_write_errors(folder: Path, name: str) -> AbstractContextManager[None]:
    """Return a context in which a picture is written; its OSErrors become `DatasetError`."""
    remedy = "make room and run the same command again, which goes on from here"
    return DatasetError.replace_os_errors(f"{name} cannot be written", path=folder, remedy=remedy)
