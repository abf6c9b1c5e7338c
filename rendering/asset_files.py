"""A plan's asset files on a cluster: the files that a worker needs, and its copies of them.

A worker uses an asset in place if the client's paths lead to the same contents on the worker's machine. Otherwise it
keeps each content once, by its SHA-256, and links to it from a folder per plan, at the client's path below that folder.
Relative paths in .blend files then hold. Absolute paths are made relative in the copies.
"""

from __future__ import annotations

import glob
import hashlib
import mmap
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hulldown.base.errors import AssetError
from hulldown.base.files import open_regular
from hulldown.base.outside import DATA, read_file, sha256_of
from hulldown.planning.inputs.loading import Library
from hulldown.reading.confinement.blocks import PATH, blocks, named_files, unpacked
from hulldown.reading.confinement.landlock import is_inside
from hulldown.rendering.jobs import readable

CACHE_VARIABLE = "HULLDOWN_CACHE"  # names the folder of a worker's copies
TILES = ("<UDIM>", "<UVTILE>")  # placeholders for a number in names of textures
CONTINUE = "restore it and run the same command again; finished images stay"
LONGEST = 1023  # bytes of a path in a .blend, without the terminator


@dataclass(frozen=True, slots=True)
class FileNote:
    """A client's file: absolute path, SHA-256, and size in bytes."""

    path: str
    sha256: str
    size: int


AssetNote = tuple[FileNote, ...]  # a file named in jobs, then the files that it refers to


class ClientFiles:
    """The client's files of a plan.

    Parameters
    ----------
    library
        The plan's assets.

    Attributes
    ----------
    assets
        The files of each asset, by the path in a job.
    key
        A hash of contents and paths.
    readable
        Paths that Blender may read where a worker has the files at the same paths, as on one machine.
    """

    def __init__(self, library: Library) -> None:
        self._notes: dict[Path, FileNote] = {}
        self.assets: dict[str, AssetNote] = {}
        named: list[tuple[Path, Sequence[str]]] = []
        named += [(exported.tidy, exported.files) for exported in library.models.values()]
        named += [(exported.tidy, exported.files) for exported in library.sceneries.values()]
        named += [(hdri.path, ()) for hdri in library.hdris.values()]
        allowed = readable(library)
        for path, files in named:
            path = path.resolve()
            self.assets[str(path)] = tuple(map(self._note, (path, *references(files, path, allowed))))
        added = [path for path in self._notes if not any(map(path.is_relative_to, allowed))]
        self.readable = (*allowed, *added)
        listed = sorted(f"{note.sha256} {note.path}" for note in self._notes.values())
        self.key = hashlib.sha256("\0".join(listed).encode("utf-8", "surrogateescape")).hexdigest()

    def content(self, digest: str) -> bytes:
        """The bytes of a noted file.

        Raises
        ------
        AssetError
            If it was changed since, or can't be read.
        """
        path = next(note.path for note in self._notes.values() if note.sha256 == digest)
        content = read_file(Path(path), partial(AssetError, path=path, remedy=CONTINUE), most=DATA)
        if hashlib.sha256(content).hexdigest() != digest:
            raise AssetError("was changed during the render", path=path, remedy=CONTINUE)
        return content

    def _note(self, path: Path) -> FileNote:
        if path not in self._notes:
            self._notes[path] = FileNote(str(path), sha256_of(path), path.stat().st_size)
        return self._notes[path]


def references(paths: Sequence[str], asset: Path, readable: Sequence[Path]) -> list[Path]:
    """The readable files that an asset refers to, each once, by normalized paths.

    Parameters
    ----------
    paths
        Absolute paths in the asset; a tiled texture stands for all its tiles.
    asset
        The asset's file.
    readable
        Folders that a render on this machine may read, besides ``HULLDOWN_READ``.
    """
    files: dict[Path, None] = {}
    for named in paths:
        path = Path(os.path.normpath(named))
        if not is_inside(path.parent, readable):
            continue  # its folder isn't listed either
        tiles = next((token for token in TILES if token in path.name), None)
        several = path.parent.glob(glob.escape(path.name).replace(tiles, "*")) if tiles else [path]
        for tile in sorted(several):
            if tile != asset and tile.is_file() and os.access(tile, os.R_OK) and is_inside(tile, readable):
                files[tile] = None
    return list(files)


def cache_folder() -> Path:
    """The folder of a worker's received files."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hulldown" / "sent"


class AssetCache:
    """A worker's copies of the client's files.

    Parameters
    ----------
    folder
        Folder of the copies.
    key
        `ClientFiles.key`, which names the folder below it that Blender may read.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.contents, self.tree = folder, folder / "plans" / key
        self.tree.mkdir(parents=True, exist_ok=True)
        self._hashes: dict[tuple[str, int, int], str] = {}  # by path, size and time of the last change

    def keep(self, content: bytes) -> str:
        """Store a content; return its SHA-256."""
        digest = hashlib.sha256(content).hexdigest()
        with self._replacing(self.contents / digest) as made:
            made.write_bytes(content)
        return digest

    def lacking(self, asset: AssetNote) -> list[str]:
        """SHA-256 of the contents that this machine lacks for an asset."""
        return [file.sha256 for file in asset if self._source(file) is None]

    def place(self, asset: AssetNote) -> Path:
        """The path of a complete asset on this machine: the client's, if all its files are at the client's paths.

        Raises
        ------
        AssetError
            If a path in a .blend becomes too long when it's made relative.
        """
        if all(self._is(Path(file.path), file) for file in asset):
            return Path(asset[0].path)
        for file in asset:
            self._lay_out(file)
        return self._place(asset[0])

    def _place(self, file: FileNote) -> Path:
        place = self.tree / file.path.lstrip("/")
        if ".." in place.parts:
            raise ValueError(f"path: expected an absolute path without detours, got {file.path!r}")
        return place

    def _lay_out(self, file: FileNote) -> None:
        place, source = self._place(file), self._source(file)
        if source is None or self._is(place, file):
            return
        rewritten = any(_is_absolute(name) for _, name in named_files(source))
        if rewritten and place.is_file():
            return
        with self._replacing(place) as made:
            if rewritten:
                _make_relative(source, made, file.path)
            else:
                _link(source, made)

    def _source(self, file: FileNote) -> Path | None:
        """A file with this content on this machine; None if there is none."""
        return next((path for path in (self.contents / file.sha256, Path(file.path)) if self._is(path, file)), None)

    def _is(self, path: Path, file: FileNote) -> bool:
        """Whether a path has a file's content, hashed again after a change of size or time."""
        try:
            stat = path.stat()
            if stat.st_size != file.size or not path.is_file():
                return False
            key = (str(path), stat.st_size, stat.st_mtime_ns)
            if key not in self._hashes:
                self._hashes[key] = sha256_of(path)
        except OSError:
            return False
        return self._hashes[key] == file.sha256

    @contextmanager
    def _replacing(self, path: Path) -> Iterator[Path]:
        """Yield a temporary path that replaces `path` when it's complete."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".", dir=path.parent) as folder:
            made = Path(folder) / path.name
            yield made
            os.replace(made, path)


def _link(source: Path, made: Path) -> None:
    try:
        os.link(source, made)
    except OSError:  # a disk without hard links, or another disk
        shutil.copyfile(source, made)


def _is_absolute(name: str) -> bool:
    return name.startswith("/") and not name.startswith("//")  # // is the folder of the .blend


def _make_relative(source: Path, made: Path, path: str) -> None:
    """Copy the .blend that the client has at `path`, with relative paths instead of absolute ones."""
    with open_regular(source) as raw, unpacked(raw) as packed, made.open("wb") as out:
        shutil.copyfileobj(packed, out)
    with made.open("r+b") as file, mmap.mmap(file.fileno(), 0) as content:
        for _, start, data in blocks(file):
            for match in PATH.finditer(data):
                name = os.fsdecode(match[1])
                if not _is_absolute(name):
                    continue
                relative = os.fsencode("//" + os.path.relpath(name, os.path.dirname(path)))
                if len(relative) > LONGEST:
                    raise AssetError(f"names {name}, which is too far away for a relative path", path=path)
                at = start + match.start(1)
                length = max(len(relative), len(match[1]))
                content[at : at + length] = relative.ljust(length, b"\0")
