"""`hulldown inspect` of any file: an asset, an HDRI, or a config with all that it lists."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from hulldown.assets.bundle import load_scenery, load_vehicle
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.planning.config.schema import Config
from hulldown.planning.inputs.loading import load_library
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.reading.hdri import read_hdris
from hulldown.reading.inspect import Inspected, draw, sky_report
from hulldown.reading.pieces.asset_report import FileReport, refuse_missing
from hulldown.reading.pieces.formats import HDRI_SUFFIXES
from hulldown.reading.reader_process import Exported, export


def drawn_assets(path: Path) -> int:
    """Return the number of vehicles and sceneries that `inspect_file` draws."""
    return len(Config.read(path).assets.entries) if _is_config(path) else int(path.suffix.lower() not in HDRI_SUFFIXES)


def inspect_file(
    path: Path,
    *,
    kind: str | None = None,
    strict: bool = False,
    pictures: bool = False,
    progress: Callable[[str], None] | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> list[Inspected]:
    """Inspect an asset or an HDRI, read without a cache, or the vehicles and sceneries of a config, in its order.

    `kind`: "vehicle" or "scenery"; None: by the asset's contents. A config's entries have their own kind.
    """
    if _is_config(path):
        library = load_library(Config.read(path), strict=strict, progress=progress, limits=limits)
        models = library.shapes
        listed: list[tuple[Exported, VehicleShape | Scenery]] = []
        for name, file in library.models.items():
            listed.append((replace(file, report=_with_limits(file.report, models[name])), models[name]))
        listed += [(file, library.assets.sceneries[name]) for name, file in library.sceneries.items()]
        return [_inspected(file, asset, pictures=pictures) for file, asset in listed]
    with tempfile.TemporaryDirectory(prefix="hulldown-") as name:
        folder = Path(name)
        if path.suffix.lower() in HDRI_SUFFIXES:
            (hdri,) = read_hdris([path], folder, limits=limits, progress=progress)
            return [Inspected(path.stem, sky_report(path, hdri))]
        if progress:
            progress(str(path))
        exported = export(path, folder, kind=kind, limits=limits)
        if strict:
            refuse_missing([exported.report], strict=True)
        load = load_vehicle if exported.report.kind == "vehicle" else load_scenery
        return [_inspected(exported, replace(load(exported.bundle), name=path.stem), pictures=pictures)]


def _inspected(file: Exported, asset: VehicleShape | Scenery, *, pictures: bool) -> Inspected:
    return Inspected(asset.name, file.report, draw(asset, file.picture) if pictures else None)


def _with_limits(report: FileReport, shape: VehicleShape) -> FileReport:
    """Return the report with the config's limits of parts."""
    limits = dict(zip(shape.part_names, shape.part_limits.tolist(), strict=True))
    parts = (replace(part, limits=(limits[part.name][0], limits[part.name][1])) for part in report.parts)
    return replace(report, parts=tuple(parts))


def _is_config(path: Path) -> bool:
    return path.suffix.lower() == ".toml"
