"""The client's side of what nodes are sent: the files that a plan is rendered from, and those that these refer to."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from reading.cache import sha256
from render.jobs import RenderAssets
from render.parcels import PIECE, AssetNote, FileNote, Piece

TILES = ("<UDIM>", "<UVTILE>")  # stand for a number in the names of textures


class ClientFiles:
    """Files of this machine by path and by content; each is hashed once.

    Parameters
    ----------
    assets
        What the plan is rendered from.
    """

    def __init__(self, assets: RenderAssets) -> None:
        files = [(vehicle.tidy, vehicle.files) for vehicle in assets.vehicles.values()]
        files += [(scenery.path, scenery.files) for scenery in assets.sceneries.values()]
        self._named = {str(path.resolve()): named for path, named in files}  # by each file as jobs have it
        self._assets: dict[str, AssetNote] = {}
        self._files: dict[Path, FileNote] = {}
        self._by_hash: dict[str, FileNote] = {}

    def asset(self, path: str) -> AssetNote:
        """What a node is told of a file that a job names."""
        if path not in self._assets:
            named = references(self._named.get(path, ()), Path(path))
            self._assets[path] = AssetNote(self._file(Path(path)), [self._file(file) for file in named])
        return self._assets[path]

    def _file(self, path: Path) -> FileNote:
        if path not in self._files:
            file = self._files[path] = note(path)
            self._by_hash[file.sha256] = file
        return self._files[path]

    def with_hash(self, sha256: str) -> FileNote | None:
        """A file of this content that nodes were told of; None if there is none."""
        return self._by_hash.get(sha256)


def note(path: Path) -> FileNote:
    """A file of this machine, as others are told of it."""
    return FileNote(str(path), sha256(path), path.stat().st_size)


def references(paths: Sequence[str], asset: Path) -> list[Path]:
    """The files of this machine among those that an asset refers to, each once."""
    found: dict[Path, None] = {}
    for named in paths:
        path = Path(os.path.normpath(named))
        tiles = next((token for token in TILES if token in path.name), None)
        several = path.parent.glob(glob.escape(path.name).replace(tiles, "*")) if tiles else [path]
        found |= {one: None for one in sorted(several) if one != asset and one.is_file() and os.access(one, os.R_OK)}
    return list(found)


def pieces(files: Iterable[FileNote]) -> Iterator[Piece]:
    """Files of this machine, cut into pieces that can be sent."""
    for file in files:
        with Path(file.path).open("rb") as content:
            for offset in range(0, max(1, file.size), PIECE):
                yield Piece(file.sha256, offset, file.size, content.read(PIECE))
