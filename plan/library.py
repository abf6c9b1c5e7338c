"""Assets of a config, read from bundles in its cache folder; missing and changed ones are exported first."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cache as cache_result
from pathlib import Path

import numpy as np

from hulldown.annotate.labels.keypoints import category_keypoint_fields
from hulldown.assets.bundle import load_scenery, load_vehicle
from hulldown.assets.plan_assets import Assets, AssetSource, GeometrySource, HdriSource, asset_fingerprint
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.arguments import AnyPath
from hulldown.base.code import package_version
from hulldown.base.errors import AssetError, ConfigError
from hulldown.base.terminal import reading_status
from hulldown.geometry.transforms import transform_points
from hulldown.plan.config.asset_sections import CACHE_NAME, DistractorEntry, ModelEntry, PaintEntry, SceneryEntry, VehicleEntry
from hulldown.plan.config.schema import Config
from hulldown.plan.lines import PlanFile
from hulldown.reading.cache import cached_export_and_digest
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.reading.doubts import format_length, likely_scale_text
from hulldown.reading.hdri import Hdri, read_hdris, require_hdri_file
from hulldown.reading.pieces.asset_report import FileReport, MaterialRow, refuse_missing_files
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.pieces.formats import HDRI_SUFFIXES
from hulldown.reading.pieces.naming import first_matching_pattern, name_matches_pattern
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.wording import quote_names
from hulldown.reading.reader_process import Exported
from hulldown.reading.vehicle.part_names import GUN_PART, TURRET_PART

USUAL_LENGTHS_M = {  # the longest with gun or trailer
    ("car", "suv", "sedan", "jeep", "hatchback", "pickup", "van", "taxi"): (2.0, 9.0),
    ("truck", "lorry", "bus", "launcher", "howitzer", "artillery"): (3.0, 30.0),
    ("tank", "mbt", "apc", "ifv"): (3.0, 16.0),
}
ANY_VEHICLE, ANY_LENGTH = ("vehicle",), (0.2, 100.0)


@dataclass(frozen=True, eq=False, slots=True)
class Library:
    """A config's assets by name, as they were read."""

    assets: Assets
    # models, sceneries: report, bundle, and tidy twin of the file of each vehicle or distractor, and of each scenery
    models: Mapping[str, Exported]
    sceneries: Mapping[str, Exported]
    hdris: Mapping[str, Hdri]  # the rendered copy of each HDRI, and its light

    @property
    def shapes(self) -> dict[str, VehicleShape]:
        """Vehicles and distractors."""
        return {**self.assets.vehicles, **self.assets.distractors}

    def doubts(self, *, backdrop: bool) -> dict[str, list[Doubt]]:
        """Return doubts by the file's path; `backdrop` tells whether pictures show all of an HDRI, with its land."""
        files = self.assets.files["hdris"]
        doubts = [(e.report.path, e.report.doubts) for e in (*self.models.values(), *self.sceneries.values())]
        for name, hdri in self.hdris.items():
            doubts.append((files[name].path, (*hdri.repair_doubts, *hdri.doubts, *hdri.misfit_doubts[:backdrop])))
        found: dict[str, dict[Doubt, None]] = {}
        for path, lines in doubts:  # a file may have several vehicles
            found.setdefault(path, {}).update(dict.fromkeys(lines))
        return {path: list(lines) for path, lines in found.items() if lines}


def hdri_paths_by_name(config: Config) -> dict[str, Path]:
    """Return name and path of every HDRI that `assets.hdris` matches, in the order of the patterns, then by name."""
    paths: dict[str, Path] = {}
    for pattern in config.assets.hdris:
        folder = Path(Path(pattern).anchor) if Path(pattern).is_absolute() else config.folder
        relative = str(Path(pattern).relative_to(folder)) if Path(pattern).is_absolute() else pattern
        try:
            matches = sorted(p for p in folder.glob(relative) if p.is_file())
        except (ValueError, NotImplementedError, OSError) as error:
            raise ConfigError(f"assets.hdris: {pattern!r} isn't a file pattern ({error})", path=config.path) from None
        if wrong := [match.name for match in matches if match.suffix.lower() not in HDRI_SUFFIXES]:
            raise ConfigError(
                f"assets.hdris: {pattern!r} matches {wrong[0]!r}, which isn't a {' or '.join(HDRI_SUFFIXES)} file",
                path=config.path,
                remedy="narrow the pattern, such as 'hdris/*.exr'",
            )
        if not matches:
            raise ConfigError(
                f"assets.hdris: {pattern!r} matches no file in {folder}",
                path=config.path,
                remedy="put .exr or .hdr files there or change the pattern",
            )
        for match in matches:
            if paths.setdefault(match.stem, match) != match:
                raise ConfigError(
                    f"assets.hdris: {paths[match.stem]} and {match} have the same name",
                    path=config.path,
                    remedy="rename one of them",
                )
    return paths


def load_library(
    config: Config,
    *,
    strict: bool = False,
    cache: AnyPath | None = None,
    progress: Callable[[str], None] | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> Library:
    """Return the assets of a config, from `cache` or the config's; `progress` gets each path (None: a status line)."""
    if progress is None:
        with reading_status() as status:
            return load_library(config, strict=strict, cache=cache, progress=status, limits=limits)
    limits.refuse_or_warn_unconfined()
    cache = config.folder / config.assets.cache if cache is None else Path(cache)
    hdris = hdri_paths_by_name(config)
    for path in hdris.values():
        require_hdri_file(path)  # before the long work
    at_once = min(4, os.cpu_count() or 1)
    shared = replace(limits, share=at_once)

    def read(entry: ModelEntry | SceneryEntry) -> tuple[Exported, str]:
        kind = "scenery" if isinstance(entry, SceneryEntry) else "vehicle"
        options = reading_options(entry, config)
        path = config.folder / entry.path
        return cached_export_and_digest(path, cache, kind=kind, options=options, limits=shared, progress=progress)

    listed = config.assets
    with ThreadPoolExecutor(at_once) as pool:
        files = list(zip(listed.entries, pool.map(read, listed.entries), strict=True))
    skies = dict(zip(hdris, read_hdris(list(hdris.values()), cache, limits=limits, progress=progress), strict=True))
    refuse_odd_lengths([(entry, exported.report) for entry, (exported, _) in files if isinstance(entry, ModelEntry)])
    needed = [e.report for entry, (e, _) in files if strict or not getattr(entry, "allow_missing", True)]
    refuse_missing_files(needed, strict=strict)
    models = {e.name: _with_length_doubt(exported, e) for e, (exported, _) in files if isinstance(e, ModelEntry)}
    _refuse_unmatched_paint(config, models)
    sceneries = {e.name: exported for e, (exported, _) in files if isinstance(e, SceneryEntry)}

    vehicle_of, scenery_of = cache_result(load_vehicle), cache_result(load_scenery)  # equal files have one bundle
    read_shapes = {name: vehicle_of(exported.bundle) for name, exported in models.items()}
    read_lands = {name: scenery_of(exported.bundle) for name, exported in sceneries.items()}
    print_of = cache_result(asset_fingerprint)

    def shapes(entries: Sequence[ModelEntry]) -> dict[str, VehicleShape]:
        return {e.name: _apply_entry_to_shape(read_shapes[e.name], e, config) for e in entries}

    kinds = {"vehicles": VehicleEntry, "distractors": DistractorEntry, "sceneries": SceneryEntry}
    prints = {name: print_of(asset) for name, asset in (read_shapes | read_lands).items()}
    sources: dict[str, dict[str, AssetSource]] = {
        key: {
            e.name: GeometrySource(
                path=e.path,
                sha256=sha256,
                files={_path_from_asset_folder(config.folder / e.path, file): each for file, each in exported.hashes.items()},
                geometry=prints[e.name],
            )
            for e, (exported, sha256) in files
            if isinstance(e, kind)
        }
        for key, kind in kinds.items()
    }
    sources["hdris"] = {
        name: HdriSource(path=_config_relative_path(path, config), sha256=sky.sha256, mended_sha256=sky.mended_sha256)
        for (name, path), sky in zip(hdris.items(), skies.values(), strict=True)
    }
    assets = Assets(
        vehicles=shapes(listed.vehicles),
        categories={entry.name: entry.category for entry in listed.vehicles},
        sceneries={name: replace(land, name=name) for name, land in read_lands.items()},
        hdris=tuple(hdris),
        files=sources,
        distractors=shapes(listed.distractors),
        skies={name: sky.light for name, sky in skies.items()},
    )
    annotated = [*assets.vehicles.values(), *(assets.distractors[e.name] for e in listed.distractors if e.category)]
    # Refuses keypoints that no vehicle has, before anything is planned.
    category_keypoint_fields(annotated, config.annotate.keypoints, config.annotate.skeleton, path=config.path or config.folder)
    return Library(assets, models, sceneries, skies)


def _with_length_doubt(exported: Exported, entry: ModelEntry) -> Exported:
    """Return the export with a doubt about a vehicle's unusual length, which is refused without a scale."""
    report = exported.report
    if entry.scale is None or not (odd := odd_length_class_and_range(likely_class_names(entry), report)):
        return exported
    text = f"with its scale of {entry.scale:g} it is {format_length(max(report.size))} long, and {usual_lengths_text(*odd)}"
    return replace(exported, report=replace(report, doubts=(*report.doubts, Doubt(DoubtKind.SCALE, text))))


def _refuse_unmatched_paint(config: Config, models: Mapping[str, Exported]) -> None:
    for entry in (*config.assets.vehicles, *config.assets.distractors):
        materials = models[entry.name].report.materials
        if (pattern := unmatched_paint_pattern(entry.paint, materials)) is not None:
            raise ConfigError(
                f"paint of {entry.name!r}: {pattern!r} matches none of its materials: "
                f"{quote_names(row.name for row in materials) or 'it has none'}",
                path=config.path,
                remedy="name one of them, or take the pattern out",
            )


def unmatched_paint_pattern(paint: Sequence[PaintEntry], materials: Sequence[MaterialRow]) -> str | None:
    """Return the first pattern of a vehicle's `paint` that matches none of its materials."""
    patterns = [pattern for entry in paint for pattern in entry.materials]
    return next((p for p in patterns if not any(name_matches_pattern(row.name, p) for row in materials)), None)


def load_planned_library(plan: PlanFile, *, cache: AnyPath | None = None, limits: ReadLimits = DEFAULT_LIMITS) -> Library:
    """Return the assets of a plan; the cache in its header isn't used, since plans come from anybody."""
    own_cache = plan.path.parent / CACHE_NAME
    if not cache and own_cache.is_symlink():
        remedy = "name the folder that it leads to by --cache, if it is yours"
        raise ConfigError("is a link", path=own_cache, remedy=remedy)
    library = load_library(Config.of_plan(plan), cache=cache or own_cache, limits=limits)
    refuse_changed_assets(plan, library.assets)
    return library


def _apply_entry_to_shape(shape: VehicleShape, entry: ModelEntry, config: Config) -> VehicleShape:
    limits = shape.part_limits
    for part, bounds in ((TURRET_PART, entry.turret_limits_deg), (GUN_PART, entry.gun_limits_deg)):
        if bounds is None:
            continue
        if part not in shape.part_names:
            raise AssetError(
                f"{part}_limits_deg is given, but no {part} was found in it",
                path=config.folder / entry.path,
                remedy=f"name its objects by `{part}`, or delete {part}_limits_deg",
            )
        limits = np.where(np.array(shape.part_names)[:, None] == part, np.radians(bounds), limits)
    points = {
        key: (transform_points(shape.vehicle_from_file, np.array([point]))[0], None)
        for key, point in (entry.keypoints or {}).items()
    }
    return replace(shape, name=entry.name, part_limits=limits).with_keypoints(points)


def reading_options(entry: ModelEntry | SceneryEntry, config: Config) -> Options:
    """Return the options for reading a file: those of its entry in the config, and shared ones."""
    names = {field.name for field in fields(Options)}
    options = {key: value for key, value in entry if key in names}
    if isinstance(entry, SceneryEntry) and entry.texture:
        # Relative to the scenery's folder, so that moving the project changes nothing.
        folder = (config.folder / entry.path).parent
        options["texture"] = Path(os.path.relpath(config.folder / entry.texture, folder)).as_posix()
    return Options(**options, texture_size=config.assets.texture_size)


def _path_from_asset_folder(asset: Path, file: str) -> str:
    return Path(os.path.relpath(file, asset.resolve().parent)).as_posix()


def _config_relative_path(path: Path, config: Config) -> str:
    try:
        return path.relative_to(config.folder).as_posix()
    except ValueError:
        return str(path)


def refuse_changed_assets(plan: PlanFile, assets: Assets) -> None:
    """Refuse assets whose files have changed since planning, or whose geometry is read differently here."""
    for kind in ("vehicles", "distractors", "sceneries", "hdris"):
        planned: Mapping[str, AssetSource] = getattr(plan.header, kind)
        files = assets.files.get(kind, {})
        for name, was in planned.items():
            if name not in files or (was.sha256 and _source_digests(files[name]) != _source_digests(was)):
                raise ConfigError(
                    f"{kind}: {name!r} ({was.path}) is not what it was when this was planned",
                    path=plan.path,
                    remedy="plan again with `hulldown plan`, or bring the old file back",
                )
            if changed := _first_changed_file(was, files[name]):
                raise ConfigError(
                    f"{kind}: {changed}, of {name!r} ({was.path}), is not what it was when this was planned",
                    path=plan.path,
                    remedy="plan again with `hulldown plan`, or bring the old file back",
                )
            if not _has_same_geometry(was, files[name]):
                raise ConfigError(
                    f"{kind}: {name!r} ({was.path}) has another geometry here than when this was planned"
                    f" ({_blender_versions_text(plan)})",
                    path=plan.path,
                    remedy="plan again here, or use the Blender that it was planned with",
                )


def _source_digests(source: AssetSource) -> tuple[str, str]:
    return source.sha256, source.mended_sha256 if isinstance(source, HdriSource) else ""


def _first_changed_file(was: AssetSource, now: AssetSource) -> str:
    """Return the first texture or library that has changed; empty if there is none, or the plan doesn't list any."""
    if not (isinstance(was, GeometrySource) and isinstance(now, GeometrySource) and was.files):
        return ""
    names = sorted({*was.files, *now.files})
    return next((each for each in names if was.files.get(each, "") != now.files.get(each, "")), "")


def _has_same_geometry(was: AssetSource, now: AssetSource) -> bool:
    if not (isinstance(was, GeometrySource) and isinstance(now, GeometrySource) and was.geometry and now.geometry):
        return True
    return was.geometry.agrees_with_other(now.geometry)


def _blender_versions_text(plan: PlanFile) -> str:
    return f"with bpy {plan.header.versions.get('bpy', 'unknown')}; here is {package_version('bpy') or 'none'}"


def refuse_odd_lengths(vehicles: Sequence[tuple[ModelEntry, FileReport]]) -> None:
    """Refuse vehicles of unusual length for their class, unless the config gives their scale."""
    found = [(entry, odd_length_class_and_range(likely_class_names(entry), report), report) for entry, report in vehicles]
    refused = [(entry, odd, report) for entry, odd, report in found if entry.scale is None and odd is not None]
    if refused:
        others = [f"{entry.name} ({format_length(max(report.size))})" for entry, _, report in refused[1:]]
        _, (kind, lengths), report = refused[0]
        several = next((str(doubt) for doubt in report.doubts if doubt.kind == DoubtKind.SEVERAL), "")
        raise AssetError(
            f"is {format_length(max(report.size))} long, and {usual_lengths_text(kind, lengths)}"
            + (f"; of unusual length are also {', '.join(others)}" if others else ""),
            path=report.path,
            remedy=several
            or f"set scale{likely_scale_text(max(report.size), report.unit, lengths)}, also to the value that "
            "it has now if the size is right",
        )


def likely_class_names(entry: ModelEntry) -> tuple[str, str]:
    """Return the names that may tell a vehicle's class, the most reliable first."""
    return getattr(entry, "category", None) or "", entry.name


def odd_length_class_and_range(names: Sequence[str], report: FileReport) -> tuple[str, tuple[float, float]] | None:
    """Return the class by these names and its usual lengths, if the vehicle's length isn't usual."""
    told = ([kind for kind in USUAL_LENGTHS_M if first_matching_pattern(name, kind)] for name in names)
    kinds = next(filter(None, told), [ANY_VEHICLE])  # several of "car-truck-tanker"
    lows, highs = zip(*(USUAL_LENGTHS_M.get(kind, ANY_LENGTH) for kind in kinds), strict=True)
    low, high = min(lows), max(highs)
    return None if low <= max(report.size) <= high else (kinds[0][0], (low, high))


def with_odd_length_doubt(report: FileReport, *names: str) -> FileReport:
    """Return the report with a doubt about a vehicle's length that `plan` would refuse with these names."""
    odd = odd_length_class_and_range(names, report) if report.kind == "vehicle" else None
    if odd is None or any(doubt.kind == DoubtKind.SCALE for doubt in report.doubts):
        return report
    length = max(report.size)
    text = f"it is {format_length(length)} long, and {usual_lengths_text(*odd)}; set scale"
    doubt = Doubt(DoubtKind.SCALE, f"{text}{likely_scale_text(length, report.unit, odd[1])}")
    return replace(report, doubts=(*report.doubts, doubt))


def usual_lengths_text(kind: str, usual: tuple[float, float]) -> str:
    """Return the usual lengths of a class as the end of a sentence."""
    return f"a {kind} has {usual[0]:g} to {usual[1]:g} m"
