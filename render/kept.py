"""The assets that a node of a cluster uses: where they lie on its disk, or copies by their SHA-256 in its cache."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from geometry.errors import AssetError
from reading.cache import sha256
from reading.landlock import asset_folders
from render.parcels import PIECE, AssetNote, FileNote, Piece

CACHE_VARIABLE = "HULLDOWN_CACHE"  # names the folder of a node's copies


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

    def place(self, asset: AssetNote) -> Path | None:
        """Where the content of an asset is on this machine; None if it must be sent.

        Raises
        ------
        AssetError
            If a file that the asset refers to is not here: such files are not sent.
        """
        here = Path(asset.file.path)
        copy = self._copy(asset.file)
        found = here if self._is(here, asset.file) else copy if self._is(copy, asset.file) else None
        for file in asset.references:
            if not self._is(Path(file.path), file):
                raise AssetError(
                    f"lacks {file.path}, which {here.name} refers to",
                    remedy="pack it into the file, or let all machines see it under that path",
                )
        return found

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

    def _copy(self, file: FileNote) -> Path:
        return self.folder / file.sha256

    def _is(self, path: Path, file: FileNote) -> bool:
        """Whether a file has the content that it must have."""
        try:
            stat = path.stat()
            if not path.is_file() or stat.st_size != file.size:
                return False
            key = (str(path), stat.st_size, stat.st_mtime_ns)
            if key not in self._hashes:
                self._hashes[key] = sha256(path)
        except OSError:
            return False
        return self._hashes[key] == file.sha256


def readable(paths: Iterable[Path]) -> list[Path]:
    """The folders that a Blender must be able to read which uses these files."""
    return list(dict.fromkeys(folder for path in paths for folder in asset_folders(path)))


def note(path: Path) -> FileNote:
    """A file of this machine, as others are told of it."""
    return FileNote(str(path), sha256(path), path.stat().st_size)


def pieces(files: Iterable[FileNote]) -> Iterator[Piece]:
    """Files of this machine, cut into pieces that can be sent."""
    for file in files:
        with Path(file.path).open("rb") as content:
            for offset in range(0, max(1, file.size), PIECE):
                yield Piece(file.sha256, offset, file.size, content.read(PIECE))
