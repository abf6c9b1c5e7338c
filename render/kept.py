"""The assets that a node of a cluster uses: where they lie on its disk, or copies by their SHA-256 in its cache."""

from __future__ import annotations

import os
from pathlib import Path

from geometry.errors import AssetError
from reading.cache import sha256
from reading.landlock import asset_folders
from render.parcels import AssetNote, FileNote, Piece
from render.placed import is_whole, key_of, lay_out, place_in
from render.sent import pieces

CACHE_VARIABLE = "HULLDOWN_CACHE"  # names the folder of a node's copies
PLACED_NAME = "placed"  # folder of assets that refer to other files


def cache_folder() -> Path:
    """Where a node keeps what it was sent."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hulldown" / "sent"


class Kept:
    """Files by their content.

    Parameters
    ----------
    folder
        Of copies; made when the first is kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._hashes: dict[tuple[str, int, int], str] = {}  # of a file as it was, by path, size and time

    def lacking(self, asset: AssetNote) -> list[str]:
        """The files of an asset that must be sent before it has a place, by their SHA-256."""
        if self._lies_here(asset):
            return []
        return [file.sha256 for file in asset.files if self._content(file) is None]

    def place(self, asset: AssetNote) -> Path:
        """Where an asset of which nothing is lacking is on this machine, with all that it refers to.

        That is where the client has it, or in the folder of copies.

        Raises
        ------
        AssetError
            If it is so deep in its folders that a path in it cannot be made relative.
        """
        if self._lies_here(asset):
            return Path(asset.file.path)
        if not asset.references:
            return self._kept(asset.file)
        folder = self.folder / PLACED_NAME / key_of(asset.files)
        if not is_whole(folder, self._holds):
            lay_out(folder, asset.files, self._kept)
        return place_in(folder, asset.file.path)

    def readable(self, asset: AssetNote) -> list[Path]:
        """The folders that a Blender must be able to read which uses an asset where `place` has it."""
        if not self._lies_here(asset):
            return [self.folder]
        return list(dict.fromkeys(folder for file in asset.files for folder in asset_folders(Path(file.path))))

    def keep(self, piece: Piece) -> None:
        """Add a piece to a copy; the pieces of a file come in order.

        Raises
        ------
        AssetError
            If the file that is whole now is not the one that was meant.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        final = self.folder / piece.sha256
        growing = self.folder / f".{piece.sha256}.{os.getpid()}"
        with growing.open("r+b" if piece.offset else "wb") as file:
            file.seek(piece.offset)
            file.write(piece.content)
            file.flush()
            os.fsync(file.fileno())
        if piece.offset + len(piece.content) < piece.size:
            return
        if sha256(growing) != piece.sha256:
            growing.unlink()
            raise AssetError(f"was sent a file that is not the one of SHA-256 {piece.sha256[:12]}")
        os.replace(growing, final)

    def _lies_here(self, asset: AssetNote) -> bool:
        """Whether this machine has it, and all that it refers to, where the client has it."""
        return all(self._is(Path(file.path), file) for file in asset.files)

    def _content(self, file: FileNote) -> Path | None:
        """A file with this content; None if there is none."""
        return next((path for path in (self.folder / file.sha256, Path(file.path)) if self._is(path, file)), None)

    def _kept(self, file: FileNote) -> Path:
        """The copy of a file that is not lacking, made if there is none."""
        copy = self.folder / file.sha256
        if not self._is(copy, file):
            for piece in pieces([file]):
                self.keep(piece)
        return copy

    def _is(self, path: Path, file: FileNote) -> bool:
        """Whether a file has the content that it must have."""
        try:
            return path.stat().st_size == file.size and self._holds(path, file.sha256)
        except OSError:
            return False

    def _holds(self, path: Path, digest: str) -> bool:
        """Whether a file has the content of a SHA-256; computed anew where its size or time is not what it was."""
        try:
            stat = path.stat()
            if not path.is_file():
                return False
            key = (str(path), stat.st_size, stat.st_mtime_ns)
            if key not in self._hashes:
                self._hashes[key] = sha256(path)
        except OSError:
            return False
        return self._hashes[key] == digest
