"""`hulldown inspect` of any file: an asset, an HDRI, or a config with all that it lists."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from hulldown.assets.bundle import load_scenery, load_vehicle
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.arguments import AnyPath, PngFile
from hulldown.base.errors import AssetError
from hulldown.base.terminal import reading_status
from hulldown.pictures.own_files import require_replaceable_picture
from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_library, with_odd_length_doubt
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.reading.hdri import read_hdris
from hulldown.reading.inspect import Inspected, draw_asset, sky_report, write_inspection_picture
from hulldown.reading.pieces.asset_report import FileReport, SkyReport, refuse_missing_files
from hulldown.reading.pieces.formats import HDRI_SUFFIXES
from hulldown.reading.reader_process import Exported, export_asset


@dataclass(frozen=True, eq=False, slots=True)
class Inspection:
    """The reports about files, and a picture of what was read."""

    reports: list[FileReport | SkyReport]
    picture: Path | None  # the file that was written
    refused: int  # number of unusable files, each of which gave a warning


def inspect_files(
    files: Sequence[AnyPath],
    *,
    output: PngFile | None = None,
    kind: Annotated[Literal["vehicle", "scenery"] | None, Parameter(name="--as")] = None,
    strict: bool = False,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> Inspection:
    """Show how asset files are read.

    Reads .blend, .glb, .gltf, .fbx, .obj, .tif, .exr or .hdr files, or configs and what they list, with their options;
    shows a table of each, and writes a picture of vehicles and sceneries from four sides.

    Parameters
    ----------
    files
        Assets, or configs (.toml).
    output
        Shaded picture, parts in colors.
    kind
        What the files are; by default decided by their contents. A config's entries have their own kind.
    strict
        Refuse files with missing textures or libraries.
    limits
        Time and memory for reading an asset.
    """
    paths, output = [Path(file) for file in files], None if output is None else Path(output)
    if output:
        require_replaceable_picture(output)
    limits.refuse_or_warn_unconfined()
    inspected: list[Inspected] = []
    refused = 0
    for path in paths:
        try:
            with reading_status() as progress:
                inspected += inspect_file(
                    path, kind=kind, strict=strict, pictures=bool(output), progress=progress, limits=limits
                )
        except AssetError as error:
            if len(paths) == 1:
                raise
            warnings.warn(str(error), stacklevel=2)
            refused += 1
    drawn = output if any(one.picture for one in inspected) else None
    if drawn:
        write_inspection_picture(inspected, drawn)
    return Inspection([one.report for one in inspected], drawn, refused)


def inspect_file(
    path: Path,
    *,
    kind: str | None = None,
    strict: bool = False,
    pictures: bool = False,
    progress: Callable[[str], None] | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> list[Inspected]:
    """Inspect an asset or HDRI of this kind (None: by its contents) without a cache, or all assets of a config."""
    if _is_config(path):
        library = load_library(Config.read(path), strict=strict, progress=progress, limits=limits)
        models = library.shapes
        listed: list[tuple[Exported, VehicleShape | Scenery]] = []
        for name, file in library.models.items():
            listed.append((replace(file, report=_with_part_limits(file.report, models[name])), models[name]))
        listed += [(file, library.assets.sceneries[name]) for name, file in library.sceneries.items()]
        return [_inspect_entry(file, asset, pictures=pictures) for file, asset in listed]
    with tempfile.TemporaryDirectory(prefix="hulldown-") as name:
        folder = Path(name)
        if path.suffix.lower() in HDRI_SUFFIXES:
            (hdri,) = read_hdris([path], folder, limits=limits, progress=progress)
            return [Inspected(path.stem, sky_report(path, hdri))]
        if progress:
            progress(str(path))
        exported = export_asset(path, folder, kind=kind, limits=limits)
        exported = replace(exported, report=with_odd_length_doubt(exported.report, path.stem))
        if strict:
            refuse_missing_files([exported.report], strict=True)
        load = load_vehicle if exported.report.kind == "vehicle" else load_scenery
        return [_inspect_entry(exported, replace(load(exported.bundle), name=path.stem), pictures=pictures)]


def _inspect_entry(file: Exported, asset: VehicleShape | Scenery, *, pictures: bool) -> Inspected:
    return Inspected(asset.name, file.report, draw_asset(asset, file.picture, file.differences) if pictures else None)


def _with_part_limits(report: FileReport, shape: VehicleShape) -> FileReport:
    limits = dict(zip(shape.part_names, shape.part_limits.tolist(), strict=True))
    parts = (replace(part, limits=(limits[part.name][0], limits[part.name][1])) for part in report.parts)
    return replace(report, parts=tuple(parts))


def _is_config(path: Path) -> bool:
    return path.suffix.lower() == ".toml"
