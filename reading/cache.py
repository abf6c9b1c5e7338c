"""A cache of exports by content; only entries sealed with a key of the user's account are used."""

from __future__ import annotations

import hmac
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec
from filelock import FileLock

from hulldown.assets.bundle import BUNDLE_FORMAT
from hulldown.base.errors import AssetError
from hulldown.base.files import atomic_writer, open_regular_file
from hulldown.base.outside import convert_value, file_sha256, parse_json, read_file
from hulldown.reading.confinement.landlock import is_in_readable_folder, readable_asset_folders, unconfined_reason
from hulldown.reading.confinement.references import files_near_asset
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.pieces.formats import file_format
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import Exported, export_asset, exported_in_folder

EXPORTER_VERSION = 41
NOTE_NAME = "entry.json"
MAX_NOTE_BYTES = 1 << 26
KEY_BYTES = 32
Note = TypeVar("Note")
FilePrint = tuple[int, int, str]  # of a file: its size, its time, and its content's digest


@dataclass(frozen=True, slots=True)
class _Note:
    """The asset's resolved path, its report, and other inputs that the report depends on."""

    path: str
    report: FileReport
    files: dict[str, FilePrint | None]  # files that the asset refers to; None for a file that can't be read
    namesakes: list[str]  # see `_namesakes_of_missing`


@dataclass(frozen=True, slots=True)
class _Sealed:
    """The content that an entry's seal covers: the entry's name, hashes of its files, and a note."""

    name: str
    content: dict[str, str]
    note: object


def cached_export_and_digest(
    path: Path | str,
    cache: Path | str,
    *,
    kind: str | None,
    options: Options,
    limits: ReadLimits = DEFAULT_LIMITS,
    progress: Callable[[str], None] | None = None,
) -> tuple[Exported, str]:
    """Return the export of `path`, from a sealed entry if nothing changed, and its SHA-256; no `kind`: by contents."""
    path, cache = Path(path), Path(cache)
    file_format(path)  # before it is hashed: a folder or nothing at all has no content
    digest = file_sha256(path)
    entries = {
        each: cache / cache_entry_name(EXPORTER_VERSION, BUNDLE_FORMAT, each, asdict(options), digest)
        for each in ([kind] if kind else ["vehicle", "scenery"])
    }
    make_cache_folder(cache)
    # Two plans must not export the same file at once.
    with _acquire_entry_lock(next(iter(entries.values()))):
        exported = next((found for entry in entries.values() if (found := _valid_cached_export(entry, path))), None)
        if exported is None:
            if progress:
                progress(str(path))
            with temporary_entry_folder(cache) as folder:
                made = export_asset(path, folder, kind=kind, options=options, limits=limits)
                files = {file: _file_fingerprint(Path(file), path) for file in made.files}
                entry = entries[made.report.kind]
                store_sealed_entry(
                    Path(folder),
                    entry,
                    _Note(str(path.resolve()), made.report, files, _namesakes_of_missing(path, made.report)),
                )
            exported = _valid_cached_export(entry, path)
            assert exported is not None, f"{entry}: an export just written cannot be read back"
    return exported, digest


def _valid_cached_export(entry: Path, path: Path) -> Exported | None:
    note = read_sealed_note(entry, _Note)
    # Relative paths of textures change their meaning in another folder.
    if note is None or ((note.files or note.report.missing) and note.path != str(path.resolve())):
        return None
    if not all(_is_file_unchanged(Path(file), was, path) for file, was in note.files.items()):
        return None
    if note.namesakes != _namesakes_of_missing(path, note.report):
        return None
    hashes = {file: was and was[2] for file, was in note.files.items()}
    return replace(exported_in_folder(entry, replace(note.report, path=str(path)), note.files), hashes=hashes)


def _namesakes_of_missing(path: Path, report: FileReport) -> list[str]:
    """Return files near an asset with the names of its missing files, which may be read in their place."""
    names = {re.split(r"[/\\]", missing.path)[-1].lower() for missing in report.missing}
    return sorted(str(file) for file in files_near_asset(path) if file.name.lower() in names) if names else []


def make_cache_folder(cache: Path) -> None:
    """Create the folder of a cache if it is missing."""
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise AssetError(f"cannot be created ({error})", path=cache) from None


def _acquire_entry_lock(entry: Path) -> AbstractContextManager[object]:
    lock = FileLock(f"{entry}.lock")
    try:
        return lock.acquire()
    except OSError as error:
        remedy = "delete it, or let yourself write to its folder"
        raise AssetError(f"cannot be opened ({error.strerror})", path=lock.lock_file, remedy=remedy) from None


def temporary_entry_folder(cache: Path) -> tempfile.TemporaryDirectory[str]:
    """Yield a temporary folder in the cache for a new entry, removed after the block unless it was sealed."""
    return tempfile.TemporaryDirectory(prefix=".new-", dir=cache.resolve(), ignore_cleanup_errors=True)


def cache_entry_name(*parts: object) -> str:
    """Return the name of the entry made from `parts`; it's different for every user."""
    return hmac.digest(_load_or_make_secret_key(), json.dumps(parts).encode(), "sha256").hex()[:24]


def store_sealed_entry(made: Path, entry: Path, note: object) -> None:
    """Turn the folder `made` into the entry `entry`, with a sealed note, a dataclass, and hashes of its files."""
    content = {file.name: file_sha256(file) for file in sorted(made.iterdir()) if file.is_file()}
    body = json.dumps(msgspec.to_builtins(_Sealed(entry.name, content, note)), indent=1).encode()
    with atomic_writer(made / NOTE_NAME) as file:
        file.write(_seal_of_bytes(body) + b"\n" + body)
    if entry.is_symlink() or entry.is_file():
        entry.unlink()
    elif entry.exists():
        shutil.rmtree(entry)
    os.replace(made, entry)


def read_sealed_note(entry: Path, kind: type[Note]) -> Note | None:
    """Return the note of an entry, of this type; None unless this user sealed it and its files are unchanged."""
    try:
        if entry.is_symlink():
            return None
        with open_regular_file(entry / NOTE_NAME) as file:
            line, body = file.readline(1 << 10), file.read(MAX_NOTE_BYTES)
        if not hmac.compare_digest(line.strip(), _seal_of_bytes(body)):
            return None
        sealed = parse_json(body, _Sealed)
        same = all(file_sha256(entry / name) == digest for name, digest in sealed.content.items())
    except OSError:
        return None
    return convert_value(sealed.note, kind) if same and sealed.name == entry.name else None


def _seal_of_bytes(body: bytes) -> bytes:
    return hmac.digest(_load_or_make_secret_key(), body, "sha256").hex().encode()


def _load_or_make_secret_key() -> bytes:
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    path = state / "hulldown" / "cache.key"
    try:
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            with FileLock(path.with_suffix(".lock")):
                if not path.is_file():
                    with atomic_writer(path) as file:
                        os.chmod(file.name, 0o600)
                        file.write(secrets.token_bytes(KEY_BYTES))
    except OSError as error:
        problem = f"cannot be read or made ({error.strerror}), and the cache is sealed with it"
        raise AssetError(problem, path=path, remedy="set XDG_STATE_HOME to a folder that you can write to") from None
    key = read_file(path, partial(AssetError, path=path, remedy="delete it"), most=1 << 10)
    if len(key) != KEY_BYTES:
        raise AssetError(f"has {len(key)} bytes, expected {KEY_BYTES}", path=path, remedy="delete it")
    return key


def _file_fingerprint(file: Path, asset: Path, *, known: FilePrint | None = None) -> FilePrint | None:
    """Return size, time, and content of a file that an asset refers to; None if the confined reader can't open it."""
    if not (unconfined_reason() or is_in_readable_folder(file, readable_asset_folders(asset))):
        return None
    try:
        stat = file.stat()
        if known and known[:2] == (stat.st_size, stat.st_mtime_ns):
            return known
        return stat.st_size, stat.st_mtime_ns, file_sha256(file)
    except OSError:
        return None


def _is_file_unchanged(file: Path, was: FilePrint | None, asset: Path) -> bool:
    now = _file_fingerprint(file, asset, known=was)
    return now is was if now is None or was is None else now[2] == was[2]
