"""Exports kept by the content of what they were made from, so that a file is read again only when it has changed."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from filelock import FileLock

from assets.bundle import FORMAT
from geometry.errors import AssetError
from reading.build import Options
from reading.export import Exported, export
from reading.formats import format_of
from reading.report import FileReport
from reading.watch import DEFAULT_LIMITS, ReadLimits

EXPORTER = 11
CHUNK = 1 << 20


def cached(
    path: Path | str,
    cache: Path | str,
    *,
    kind: str,
    options: Options,
    limits: ReadLimits = DEFAULT_LIMITS,
    progress: Callable[[str], None] | None = None,
) -> tuple[Exported, str]:
    """What reading `path` leaves behind, out of `cache` if it is there, and the SHA-256 of the file.

    An entry counts if file, options and exporter are the same and every texture and library that the file refers to
    is as it was.

    Parameters
    ----------
    path
        The asset's file.
    cache
        Folder; made if missing.
    kind
        "vehicle" or "scenery".
    options
        How to read it.
    limits
        When reading it is given up.
    progress
        Called with the path if it has to be exported.

    Raises
    ------
    AssetError
        If the file cannot be read.
    """
    path, cache = Path(path), Path(cache)
    format_of(path)  # before it is hashed: a folder or nothing at all has no content
    digest = sha256(path)
    key = hashlib.sha256(json.dumps([EXPORTER, FORMAT, kind, asdict(options), digest]).encode()).hexdigest()[:24]
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise AssetError(f"cannot be made as cache folder ({error})", path=cache) from None
    # Two plans at a time must not export the same file into each other's feet.
    with FileLock(cache / f"{key}.lock"):
        entry = cache / key
        exported = _entry(entry, path)
        if exported is None:
            if progress:
                progress(str(path))
            _export_into(entry, path, kind, options, limits)
            exported = _entry(entry, path)
            assert exported is not None, f"{entry}: an export just written cannot be read back"
    return exported, digest


def _export_into(entry: Path, path: Path, kind: str, options: Options, limits: ReadLimits) -> None:
    unfinished = Path(tempfile.mkdtemp(prefix=f".{entry.name}.", dir=entry.parent))
    try:
        exported = export(path, unfinished, kind=kind, options=options, limits=limits)
        note = {
            "path": str(path.resolve()),
            "report": exported.report.to_json(),
            "files": {file: _print_of(Path(file)) for file in exported.files},
        }
        (unfinished / "entry.json").write_text(json.dumps(note, indent=1), encoding="utf-8")
        if entry.exists():
            shutil.rmtree(entry)
        os.replace(unfinished, entry)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _entry(entry: Path, path: Path) -> Exported | None:
    """The entry, if it is whole and nothing that it was made from has changed."""
    bundle, tidy = entry / "bundle.npz", entry / "tidy.blend"
    try:
        note = json.loads((entry / "entry.json").read_text(encoding="utf-8"))
        report = FileReport.from_json({**note["report"], "path": str(path)})
        files: Mapping[str, Any] = note["files"]
        # Relative paths of textures mean something else in another folder.
        if (files or report.missing) and note["path"] != str(path.resolve()):
            return None
        if not all(_unchanged(Path(file), was) for file, was in files.items()) or not tidy.is_file():
            return None
    except (OSError, ValueError, KeyError, TypeError):
        return None
    if not zipfile.is_zipfile(bundle):
        return None
    return Exported(report, bundle, tidy, tuple(files))


def _print_of(file: Path) -> list[Any] | None:
    """Size, time and content of a file; None if it is not there."""
    try:
        stat = file.stat()
        return [stat.st_size, stat.st_mtime_ns, sha256(file)] if file.is_file() else None
    except OSError:
        return None


def _unchanged(file: Path, was: list[Any] | None) -> bool:
    try:
        stat = file.stat()
    except OSError:
        return was is None
    if was is None:
        return not file.is_file()
    return [stat.st_size, stat.st_mtime_ns] == was[:2] or (stat.st_size == was[0] and sha256(file) == was[2])


def sha256(path: Path) -> str:
    """Hexadecimal digest of a file's bytes."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while chunk := file.read(CHUNK):
            digest.update(chunk)
    return digest.hexdigest()
