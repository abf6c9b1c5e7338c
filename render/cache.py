"""Assets of a config, read from bundles in its cache folder; what is missing or changed is exported first."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from filelock import FileLock

from assets.bundle import FORMAT, load_scenery, load_vehicle
from geometry.errors import AssetError
from planning.config import Config, hdri_paths
from planning.inputs import AssetFile, Assets
from planning.schema import SceneryEntry, VehicleEntry
from render.build import Options
from render.export import Exported, export
from render.formats import format_of
from render.report import FileReport

EXPORTER = 1  # raised whenever the same file would be read as something else
CHUNK = 1 << 20


@dataclass(frozen=True, eq=False, slots=True)
class Library:
    """A config's assets and what reading each of their files left behind, by the assets' names.

    Parameters
    ----------
    assets
        For the planner.
    vehicles, sceneries
        Report, bundle and tidy twin of each file.
    """

    assets: Assets
    vehicles: Mapping[str, Exported]
    sceneries: Mapping[str, Exported]

    @property
    def doubts(self) -> tuple[str, ...]:
        """What a person should look at, a line each, beginning with the file's path."""
        exported = [*self.vehicles.values(), *self.sceneries.values()]
        return tuple(f"{e.report.path}: {doubt}" for e in exported for doubt in e.report.doubts)


def load_assets(
    config: Config,
    *,
    strict: bool = False,
    progress: Callable[[str], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> Assets:
    """Everything that a planner needs of the files that `config` names.

    Parameters
    ----------
    config
        Paths in it are relative to `config.folder`.
    strict
        Refuse files whose textures or libraries are missing.
    progress
        Called with a file's path before it is exported.
    warn
        Called with a line for everything that a person should look at.

    Raises
    ------
    AssetError
        Naming the file, what is wrong and what to do.
    """
    library = load_library(config, strict=strict, progress=progress)
    if warn:
        for doubt in library.doubts:
            warn(doubt)
    return library.assets


def load_library(
    config: Config, *, strict: bool = False, progress: Callable[[str], None] | None = None, jobs: int | None = None
) -> Library:
    """The assets of `config` with reports and tidy twins; parameters and errors as of `load_assets`.

    Parameters
    ----------
    config, strict, progress
        See `load_assets`.
    jobs
        How many files are read at a time; as many as there are cores, up to four, if None.
    """
    cache = config.folder / config.assets.cache
    hdris = hdri_paths(config)
    wanted: list[tuple[str, VehicleEntry | SceneryEntry, Options]] = []
    wanted += [("vehicle", entry, vehicle_options(entry)) for entry in config.assets.vehicles]
    wanted += [("scenery", entry, scenery_options(entry, config)) for entry in config.assets.sceneries]

    def read(kind: str, entry: VehicleEntry | SceneryEntry, options: Options) -> tuple[Exported, str]:
        return cached(config.folder / entry.path, cache, kind=kind, options=options, progress=progress)

    with ThreadPoolExecutor(jobs or min(4, os.cpu_count() or 1)) as pool:
        read_files = list(pool.map(lambda job: read(*job), wanted))
    if strict:
        refuse_missing([exported.report for exported, _ in read_files])
    vehicles = {e.name: r for (kind, e, _), r in zip(wanted, read_files, strict=True) if kind == "vehicle"}
    sceneries = {e.name: r for (kind, e, _), r in zip(wanted, read_files, strict=True) if kind == "scenery"}
    assets = Assets(
        vehicles={name: replace(load_vehicle(e.bundle), name=name) for name, (e, _) in vehicles.items()},
        categories={entry.name: entry.category for entry in config.assets.vehicles},
        sceneries={name: replace(load_scenery(e.bundle), name=name) for name, (e, _) in sceneries.items()},
        hdris=tuple(hdris),
        vehicle_files={e.name: AssetFile(e.path, vehicles[e.name][1]) for e in config.assets.vehicles},
        scenery_files={e.name: AssetFile(e.path, sceneries[e.name][1]) for e in config.assets.sceneries},
        hdri_files={name: AssetFile(_as_given(path, config), _sha256(path)) for name, path in hdris.items()},
    )
    return Library(assets, {n: e for n, (e, _) in vehicles.items()}, {n: e for n, (e, _) in sceneries.items()})


def vehicle_options(entry: VehicleEntry) -> Options:
    """How a config says that a vehicle's file is to be read."""
    return Options(
        up=entry.up,
        scale=entry.scale,
        forward=entry.forward,
        keep=entry.keep,
        drop=entry.drop,
        turret=entry.turret,
        gun=entry.gun,
    )


def scenery_options(entry: SceneryEntry, config: Config) -> Options:
    """How a config says that a scenery's file is to be read."""
    return Options(up=entry.up, scale=entry.scale, include=config.ground.include, exclude=config.ground.exclude)


def refuse_missing(reports: Sequence[FileReport]) -> None:
    """Raise if any of the files lacks a texture or a library.

    Raises
    ------
    AssetError
        Naming the first file that lacks one, what it lacks and who wants it.
    """
    for report in reports:
        if report.missing:
            first, more = report.missing[0], len(report.missing) - 1
            raise AssetError(
                f"{first.path} is missing, which {', '.join(first.wanted_by) or 'the file'} wants"
                + (f" (and {more} more)" if more else ""),
                path=report.path,
                remedy="put the file there, pack it into the .blend, or go on without --strict",
            )


def cached(
    path: Path | str,
    cache: Path | str,
    *,
    kind: str,
    options: Options,
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
    progress
        Called with the path if it has to be exported.

    Raises
    ------
    AssetError
        If the file cannot be read.
    """
    path, cache = Path(path), Path(cache)
    format_of(path)  # before it is hashed: a folder or nothing at all has no content
    digest = _sha256(path)
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
            _export_into(entry, path, kind, options)
            exported = _entry(entry, path)
            assert exported is not None, f"{entry}: an export just written cannot be read back"
    return exported, digest


def _export_into(entry: Path, path: Path, kind: str, options: Options) -> None:
    unfinished = Path(tempfile.mkdtemp(prefix=f".{entry.name}.", dir=entry.parent))
    try:
        exported = export(path, unfinished, kind=kind, options=options)
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
        return [stat.st_size, stat.st_mtime_ns, _sha256(file)] if file.is_file() else None
    except OSError:
        return None


def _unchanged(file: Path, was: list[Any] | None) -> bool:
    try:
        stat = file.stat()
    except OSError:
        return was is None
    if was is None:
        return not file.is_file()
    return [stat.st_size, stat.st_mtime_ns] == was[:2] or (stat.st_size == was[0] and _sha256(file) == was[2])


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while chunk := file.read(CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def _as_given(path: Path, config: Config) -> str:
    try:
        return path.relative_to(config.folder).as_posix()
    except ValueError:
        return str(path)
