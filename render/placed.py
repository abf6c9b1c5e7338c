"""The files of an asset, laid out in a folder of their own as they lie on the client's disk.

A .blend names textures and libraries by paths relative to itself, which hold wherever the files lie to one another as
they did, or by absolute ones, which mean nothing on another machine. These are made relative in the copy.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec
from msgspec import Struct

from geometry.errors import AssetError
from reading.blender.blocks import PATH, blocks, named_files, unpacked
from reading.cache import sha256
from render.parcels import FileNote

LAYOUT = 1  # of what this module writes
FILES_NAME, LIST_NAME = "files", "files.json"
LONGEST = 1023  # bytes of a path in a .blend; its place there has one more


class _List(Struct, frozen=True):
    """What a folder holds: each file by its path below `files`, and its SHA-256."""

    files: dict[str, str]


def key_of(files: Iterable[FileNote]) -> str:
    """What the folder for these files is called: equal for the same contents at the same places."""
    listed = sorted((file.path, file.sha256) for file in files)
    return hashlib.sha256(msgspec.json.encode([LAYOUT, listed])).hexdigest()


def lay_out(folder: Path, files: Iterable[FileNote], content: Callable[[FileNote], Path]) -> None:
    """Make a folder with these files at the places that they have on the client's disk, below `files`.

    Parameters
    ----------
    folder
        Made; whatever is there is replaced, unless another process has made it meanwhile.
    files
        By their absolute paths.
    content
        A file of this disk with the content of one of them, which may become a hard link.

    Raises
    ------
    AssetError
        If a .blend of them is so deep that a path in it cannot be made relative.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder, ignore_errors=True)
    making = Path(tempfile.mkdtemp(prefix=".", dir=folder.parent))
    try:
        listed = {}
        for file in files:
            place = making / place_in(Path(), file.path)
            place.parent.mkdir(parents=True, exist_ok=True)
            if _names_absolute_paths(content(file)):
                _make_relative(content(file), place, file.path)
                listed[file.path] = sha256(place)
            else:
                _link(content(file), place)
                listed[file.path] = file.sha256
        (making / LIST_NAME).write_bytes(msgspec.json.encode(_List(listed)))
        os.rename(making, folder)
    except OSError:
        if not (folder / LIST_NAME).is_file():
            raise
    finally:
        shutil.rmtree(making, ignore_errors=True)


def is_whole(folder: Path, holds: Callable[[Path, str], bool]) -> bool:
    """Whether a folder that `lay_out` has made is as it was.

    Parameters
    ----------
    folder
        Its path.
    holds
        Whether a file has the content of a SHA-256.
    """
    try:
        listed = msgspec.json.decode((folder / LIST_NAME).read_bytes(), type=_List)
    except (OSError, msgspec.DecodeError):
        return False
    return all(holds(place_in(folder, path), digest) for path, digest in listed.files.items())


def place_in(folder: Path, path: str) -> Path:
    """Where such a folder has the file that the client has at an absolute path."""
    return folder / FILES_NAME / Path(path).relative_to("/")


def _link(source: Path, place: Path) -> None:
    try:
        os.link(source, place)
    except OSError:  # a disk without hard links
        shutil.copyfile(source, place)


def _names_absolute_paths(blend: Path) -> bool:
    return any(_is_absolute(name) for _, name in named_files(blend))


def _is_absolute(name: str) -> bool:
    return name.startswith("/") and not name.startswith("//")  # which means the folder of the .blend


def _make_relative(source: Path, place: Path, path: str) -> None:
    """Write the .blend `source`, which the client has at `path`, with relative paths in place of absolute ones."""
    with source.open("rb") as raw, unpacked(raw) as packed, place.open("wb") as out:
        shutil.copyfileobj(packed, out)
    with place.open("r+b") as file, mmap.mmap(file.fileno(), 0) as content:
        for _, start, data in blocks(file):
            for found in PATH.finditer(data):
                name = os.fsdecode(found[1])
                if not _is_absolute(name):
                    continue
                relative = os.fsencode("//" + os.path.relpath(name, os.path.dirname(path)))
                if len(relative) > LONGEST:
                    raise AssetError(f"names {name}, which is too far away to be found from there", path=path)
                at = start + found.start(1)
                length = max(len(relative), len(found[1]))
                content[at : at + length] = relative.ljust(length, b"\0")
