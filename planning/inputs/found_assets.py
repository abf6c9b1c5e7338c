"""A config for a folder of assets, whose files are read as `hulldown inspect` reads them."""

from __future__ import annotations

import os
import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from glob import escape
from pathlib import Path
from types import MappingProxyType

from hulldown.base.errors import AssetError
from hulldown.base.outside import convert_parsed_value
from hulldown.base.terminal import track_items
from hulldown.plan.config.config_keys import config_text
from hulldown.plan.library import with_odd_length_doubt
from hulldown.reading.cache import (
    cache_entry_name,
    cached_export_and_digest,
    read_sealed_note,
    store_sealed_entry,
    temporary_entry_folder,
)
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.reading.hdri import read_hdris
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.formats import FORMAT_SUFFIXES, HDRI_SUFFIXES, OTHER_SUFFIXES
from hulldown.reading.pieces.options import DEFAULT_OPTIONS, Options

# Folder names that tell the kind of the files in them; in other folders, the contents decide.
FOUND_KINDS = {
    "vehicles": "vehicle",
    "sceneries": "scenery",
    "scenes": "scenery",
    "terrains": "scenery",
    "distractors": "distractor",
}
NO_CATEGORY = ("assets", "models", *FOUND_KINDS)
MAX_GROUND_NAMES = 4  # in a comment
EXAMPLE_COLOR = "#4b5320"  # of paint
_PREFERRED_SUFFIXES = (*FORMAT_SUFFIXES, *HDRI_SUFFIXES)  # of files with one name in several formats, the first is used
NEEDED_KINDS = {"vehicle": "vehicle", "scenery": "scenery", "hdri": "HDRI"}


@dataclass(frozen=True, slots=True)
class FoundFile:
    """A file of the folder, its kind, and lines of notes on it.

    `path` is relative to the folder. `kind` is "vehicle", "scenery", "distractor", "hdri", or "" for an unusable file,
    whose notes begin with the reason. `keys` are those of a vehicle's entry: what reading had to guess, and for each of
    a file's several vehicles keep and drop, and what its name ends in. `doubts` are among the notes. `material` is the
    one with the largest area, or empty.
    """

    path: Path
    kind: str
    notes: tuple[str, ...]
    keys: Mapping[str, object] = field(default_factory=dict)
    doubts: tuple[Doubt, ...] = ()
    material: str = ""


def relative_asset_files(folder: Path) -> list[Path]:
    """Return the paths of files with suffixes of assets, relative to `folder`, without hidden files and folders."""
    files, others = list[Path](), list[Path]()
    for inside, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        place = Path(inside).relative_to(folder)
        paths = [place / name for name in sorted(names) if name[0] != "."]
        files += [path for path in paths if path.suffix.lower() in _PREFERRED_SUFFIXES]
        others += [path for path in paths if path.suffix.lower() in OTHER_SUFFIXES]
    if others:
        kinds = ", ".join(sorted({path.suffix.lower() for path in others}))
        text = f"{len(others)} files are of formats that aren't read ({kinds}), such as {others[0]}"
        warnings.warn(f"{text}; save them as .blend in Blender", stacklevel=2)
    if not files:
        what = f"holds no {', '.join(_PREFERRED_SUFFIXES)} file" if folder.is_dir() else "is no folder"
        raise AssetError(what, path=folder, remedy="name the folder of your vehicles, sceneries and HDRIs by --from")
    return files


def read_found_files(
    folder: Path, files: Sequence[Path], cache: Path, *, limits: ReadLimits = DEFAULT_LIMITS
) -> list[FoundFile]:
    """Find the kind of each file: by the name of a folder around it, or else by its contents."""
    limits.refuse_or_warn_unconfined()
    at_once = min(4, os.cpu_count() or 1)
    shared = replace(limits, share=at_once)
    taken: dict[Path, Path] = {}  # the preferred format of files with the same name
    for path in sorted(files, key=lambda path: _PREFERRED_SUFFIXES.index(path.suffix.lower())):
        taken.setdefault(path.with_suffix(""), path)

    def read(path: Path) -> list[FoundFile]:
        if not str(path).isprintable():
            return [FoundFile(path, "", ("its name cannot be written; rename it",))]
        if (same := taken[path.with_suffix("")]) != path:
            return [FoundFile(path, "", (f"is called as {same.name} is, which is used",))]
        try:
            if path.suffix.lower() in HDRI_SUFFIXES:
                return [_read_found_hdri(folder, path, cache, shared)]
            return _read_found_models(folder, path, cache, shared)
        except AssetError as error:
            return [FoundFile(path, "", (error.problem + (f"; {error.remedy}" if error.remedy else ""),))]

    with ThreadPoolExecutor(at_once) as pool:
        reading = [pool.submit(read, path) for path in files]
        for _ in track_items("reading files", as_completed(reading), len(files)):
            pass
    read_files = [found for each in reading for found in each.result()]
    if not any(file.kind for file in read_files):
        first = next((file for file in read_files if taken[file.path.with_suffix("")] == file.path), read_files[0])
        raise AssetError(f"none of its {len(files)} files can be used; {first.path}: {first.notes[0]}", path=folder)
    return read_files


def _read_found_hdri(folder: Path, path: Path, cache: Path, limits: ReadLimits) -> FoundFile:
    sky = read_hdris([folder / path], cache, limits=limits)[0]
    if sky.misfit_doubts:
        return FoundFile(path, "", (f"shows no open land: {sky.misfit_doubts[0]}",))
    if sky.doubts:
        return FoundFile(path, "", tuple(map(str, sky.doubts)))
    return FoundFile(path, "hdri", sky.notes, doubts=sky.repair_doubts)


def _read_found_models(folder: Path, path: Path, cache: Path, limits: ReadLimits) -> list[FoundFile]:
    """Return a file's vehicles, read with the keys that it needs, or its scenery."""
    folder_kind = next((FOUND_KINDS[name.lower()] for name in reversed(path.parent.parts) if name.lower() in FOUND_KINDS), None)
    kind = "vehicle" if folder_kind == "distractor" else folder_kind

    def read(options: Options = DEFAULT_OPTIONS) -> FileReport:
        return cached_export_and_digest(folder / path, cache, kind=kind, options=options, limits=limits)[0].report

    def found(report: FileReport, keys: Mapping[str, object], *, name: str = "", why: Sequence[str] = ()) -> FoundFile:
        guessed: dict[str, object] = {doubt.key: doubt.taken for doubt in report.doubts if doubt.key}
        if guessed:
            read(convert_parsed_value({**keys, **guessed}, Options))  # for the plan
        report = with_odd_length_doubt(report, _guess_category(folder, path), path.stem)
        notes = (*why, *report.lines(), *_ground_notes(report))
        keys = {**keys, **guessed, **({"name": name} if name else {})}
        material = report.materials[0].name if report.materials else ""
        return FoundFile(path, folder_kind or report.kind, notes, keys, report.doubts, material)

    whole = read()
    if not whole.things:
        return [found(whole, {})]
    why = [f"without keep and drop: {doubt}" for doubt in whole.doubts if doubt.kind == DoubtKind.SEVERAL]
    names = [re.sub(r"\W+", "_", thing.name) for thing in whole.things]
    each = []
    for number, (thing, name) in enumerate(zip(whole.things, names, strict=True), start=1):
        keys: dict[str, object] = {key: value for key, value in (("keep", thing.keep), ("drop", thing.drop)) if value}
        unique = str(number) if name and names.count(name) > 1 else name
        each.append(found(read(convert_parsed_value(keys, Options)), keys, name=unique, why=why))
    return each


def _ground_notes(report: FileReport) -> list[str]:
    names = [row.name for row in report.rows if row.use == "ground"]
    more = f" and {len(names) - MAX_GROUND_NAMES} more" if len(names) > MAX_GROUND_NAMES else ""
    return [f"ground: {', '.join(names[:MAX_GROUND_NAMES])}{more}"] if names else []


def missing_asset_kinds(found: Sequence[FoundFile]) -> list[str]:
    """Return the required kinds of assets that weren't found."""
    return [word for kind, word in NEEDED_KINDS.items() if all(file.kind != kind for file in found)]


def found_config_text(
    folder: Path, found: Sequence[FoundFile], config_folder: Path, values: Mapping[str, object] = MappingProxyType({})
) -> str:
    """Return the text of a config in `config_folder` that lists the usable files of `folder`, with their notes."""
    base = os.path.relpath(folder.resolve(), config_folder.resolve())
    listed = {file.path: Path(base, file.path).as_posix() for file in found}
    models = {file.path for file in found if file.kind not in ("hdri", "")}
    stems = Counter(path.stem for path in models)
    skies: dict[str, Path] = {}
    unused = [file for file in found if not file.kind]
    for file in found:
        if file.kind == "hdri" and (first := skies.setdefault(file.path.stem, file.path)) != file.path:
            unused.append(replace(file, kind="", notes=(f"is called as {first.as_posix()} is; rename it to use it",)))

    def propose_entry(file: FoundFile) -> dict[str, object]:
        path, entry = file.path, {"path": listed[file.path]}
        name = "_".join((*path.parent.parts, path.stem)) if stems[path.stem] > 1 else path.stem
        name += f"_{file.keys['name']}" if "name" in file.keys else ""
        named = {"name": name} if name != path.stem else {}
        category = {"category": _guess_category(folder, path)} if file.kind == "vehicle" else {}
        keys = {k: list(v) if isinstance(v, tuple) else v for k, v in file.keys.items() if k != "name"}
        return {**entry, **named, **category, **keys}

    entries = {kind: [(propose_entry(file), file) for file in found if file.kind == kind] for kind in set(FOUND_KINDS.values())}
    patterns = {path: escape(listed[path]) for path in skies.values()}
    notes = {patterns[file.path]: file.notes for file in found if file.kind == "hdri" and file.path in patterns}
    models_by_name = {str(entry.get("name", entry["path"])): f for some in entries.values() for entry, f in some}
    notes |= {name: file.notes for name, file in models_by_name.items()}
    missing = [f"no {word} was found in {folder}, and at least one is needed" for word in missing_asset_kinds(found)]
    return config_text(
        vehicles=[entry for entry, _ in entries["vehicle"]],
        sceneries=[entry for entry, _ in entries["scenery"]],
        distractors=[entry for entry, _ in entries["distractor"]],
        hdris=list(patterns.values()),
        values=values,
        notes=notes,
        proposals={name: _paint_proposal(file.material) for name, file in models_by_name.items() if file.material},
        remarks=[*missing, *(f"not used: {listed[file.path]}: {file.notes[0]}" for file in unused)],
    )


def _paint_proposal(material: str) -> dict[str, object]:
    return {"paint": [{"materials": [material], "colors": ["own", EXAMPLE_COLOR]}]}


def store_stated_doubts(found: Sequence[FoundFile], folder: Path, config: Path, cache: Path) -> None:
    """Record in a cache which doubts about the files of `folder` a config's comments state."""
    doubts: dict[str, list[Doubt]] = {}
    for file in found:
        doubts.setdefault(str((folder / file.path).resolve()), []).extend(file.doubts)
    with temporary_entry_folder(cache) as made:
        store_sealed_entry(Path(made), _doubts_entry_path(config, cache), doubts)


def load_stated_doubts(config: Path, cache: Path) -> dict[str, list[Doubt]]:
    """Return the doubts, by resolved path, that `store_stated_doubts` recorded for a config; none for other configs."""
    return read_sealed_note(_doubts_entry_path(config, cache), dict[str, list[Doubt]]) or {}


def _doubts_entry_path(config: Path, cache: Path) -> Path:
    return cache / cache_entry_name("doubts", str(config.resolve()))


def _guess_category(folder: Path, path: Path) -> str:
    names = (*path.parent.parts, folder.resolve().name)
    return next((name for name in names if name and name.lower() not in NO_CATEGORY), "vehicle")
