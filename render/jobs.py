"""Turn a plan's rows into self-contained jobs for workers: absolute paths, matrices, and numbers."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from msgspec import structs

from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.camera.projection import NEAR
from hulldown.geometry.color import LUMINANCE, linear_color
from hulldown.geometry.errors import ConfigError
from hulldown.planning.appearance.paint import Coat
from hulldown.planning.inputs.loading import Library, load_planned_library
from hulldown.planning.plan_file import Plan
from hulldown.planning.row import PlannedVehicle, Row
from hulldown.reading.confinement.landlock import asset_folders
from hulldown.reading.confinement.watch import DEFAULT_LIMITS, ReadLimits
from hulldown.reading.vehicle.paintable import MaterialRow, painted
from hulldown.render.messages import (
    CameraInput,
    CyclesSettings,
    LightInput,
    MaskJob,
    PaintInput,
    RenderJob,
    SceneryInput,
    VehicleInput,
)

# Meters from the file's origin beyond which Blender's float32 is too coarse for pictures.
FAR = 5000.0


@dataclass(frozen=True, eq=False, slots=True)
class VehicleFile:
    """A vehicle to render.

    Parameters
    ----------
    shape
        Its geometry.
    tidy
        Its tidy twin, a .blend by `reading.blender.tidy`.
    files
        Paths of the twin's references.
    materials
        Its materials.
    source
        The config's file; None if that is the twin.
    """

    shape: VehicleShape
    tidy: Path
    files: tuple[str, ...] = ()
    materials: tuple[MaterialRow, ...] = ()
    source: Path | None = None


@dataclass(frozen=True, eq=False, slots=True)
class SceneryFile:
    """A scenery to render.

    Parameters
    ----------
    path
        Its .blend.
    scenery_from_file
        (4, 4) transform of its coordinates.
    scenery
        Its geometry.
    files
        Paths of the .blend's references.
    source
        The config's file; None if that is the .blend.
    """

    path: Path
    scenery_from_file: Float[np.ndarray, "4 4"]
    scenery: Scenery
    files: tuple[str, ...] = ()
    source: Path | None = None

    @property
    def standing(self) -> list[str]:
        """Objects planned as ground or obstacles, which are rendered whatever they or their meshes are called."""
        return sorted({*self.scenery.ground_names, *self.scenery.instance_names})


@dataclass(frozen=True, eq=False, slots=True)
class RenderAssets:
    """A plan's files by the plan's names; vehicles include distractors."""

    vehicles: Mapping[str, VehicleFile]
    sceneries: Mapping[str, SceneryFile]
    hdris: Mapping[str, Path]

    @property
    def readable(self) -> tuple[Path, ...]:
        """Paths that Blender may read: the folders of the config's files, and the HDRIs.

        Neither a plan's header nor an asset adds to it.
        """
        files = [file for vehicle in self.vehicles.values() for file in (vehicle.tidy, vehicle.source)]
        files += [file for scenery in self.sceneries.values() for file in (scenery.path, scenery.source)]
        folders = [folder for file in files if file for folder in asset_folders(Path(os.path.normpath(file)))]
        return tuple(dict.fromkeys([*folders, *self.hdris.values()]))


def render_assets(
    plan: Plan,
    *,
    cache: str | os.PathLike[str] | None = None,
    progress: Callable[[str], None] | None = None,
    limits: ReadLimits = DEFAULT_LIMITS,
) -> RenderAssets:
    """Find the files in a plan's header, exported again if they aren't in the cache.

    Parameters
    ----------
    plan
        The plan.
    cache
        The cache; see `planning.inputs.loading.load_planned_library`.
    progress
        Called with the path of each file that must be read.
    limits
        Limits of reading a file.

    Raises
    ------
    ConfigError
        If a file has changed since planning.
    AssetError
        If a file cannot be read.
    """
    library, config = load_planned_library(plan, cache=cache, progress=progress, limits=limits), plan.config
    shapes = {**library.assets.vehicles, **library.assets.distractors}
    read = library.models
    paths = {entry.name: entry.path for entry in (*config.assets.vehicles, *config.assets.distractors)}
    return RenderAssets(
        vehicles={
            name: VehicleFile(
                shape,
                read[name].tidy,
                read[name].files,
                read[name].report.materials,
                source=config.folder / paths[name],
            )
            for name, shape in shapes.items()
        },
        sceneries={
            entry.name: _scenery_file(config.folder / entry.path, library, entry.name)
            for entry in config.assets.sceneries
        },
        hdris={name: hdri.path for name, hdri in library.hdris.items()},
    )


def _scenery_file(path: Path, library: Library, name: str) -> SceneryFile:
    """The scenery's original file, or its tidy twin without hair and volumes if float32 isn't enough."""
    scenery, read = library.assets.sceneries[name], library.sceneries[name]
    if path.suffix.lower() != ".blend" or np.linalg.norm(scenery.origin) > FAR:
        return SceneryFile(read.tidy, np.eye(4), scenery, read.files, source=path)
    return SceneryFile(path, scenery.scenery_from_file, scenery, read.files)


def render_job(row: Row, assets: RenderAssets, settings: CyclesSettings, output: Path) -> RenderJob:
    """The job of rendering a row.

    Parameters
    ----------
    row
        A row of the plan.
    assets
        The plan's files.
    settings
        Cycles' settings.
    output
        The output file.

    Raises
    ------
    ConfigError
        If the row names an asset that isn't in the plan's header.
    ValueError
        If it turns a part that its vehicle doesn't have.
    """
    return RenderJob(
        scenery=_scenery(row, assets),
        vehicles=[_vehicle(vehicle, assets, row) for vehicle in row.vehicles],
        camera=_camera(row),
        light=LightInput(
            hdri=str(_named(assets.hdris, row.hdri, "hdri", row).resolve()),
            yaw=math.radians(row.hdri_yaw_deg),
            strength=row.strength,
            horizon=None if row.horizon_deg is None else math.radians(row.horizon_deg),
        ),
        weather=row.weather,
        seed=row.sample_seed % 2**31,
        settings=settings,
        output=str(output),
        sensor=row.sensor,
    )


def mask_job(row: Row, assets: RenderAssets, output: Path) -> MaskJob:
    """The job of rendering a row's masks; parameters and errors as of `render_job`."""
    vehicles = [_vehicle(structs.replace(vehicle, paint=[]), assets, row) for vehicle in row.vehicles]
    return MaskJob(scenery=_scenery(row, assets), vehicles=vehicles, camera=_camera(row), output=str(output))


def _scenery(row: Row, assets: RenderAssets) -> SceneryInput:
    file = _named(assets.sceneries, row.scenery, "scenery", row)
    removed = list(file.scenery.removed_names)
    return SceneryInput(str(file.path.resolve()), file.scenery_from_file.tolist(), file.standing, removed)


def _camera(row: Row) -> CameraInput:
    return CameraInput(
        world_from_camera=row.world_from_camera.tolist(),
        intrinsics=row.intrinsics,
        near=NEAR,
        exposure=row.exposure_ev,
        white_balance=row.white_balance_k,
    )


def _vehicle(vehicle: PlannedVehicle, assets: RenderAssets, row: Row) -> VehicleInput:
    file = _named(assets.vehicles, vehicle.vehicle, "vehicle", row)
    parts = vehicle.world_from_vehicle @ file.shape.vehicle_from_parts(vehicle.articulation)
    return VehicleInput(str(file.tidy.resolve()), parts.tolist(), _paint(vehicle.paint, file.materials))


def _paint(coats: Sequence[Coat], materials: Sequence[MaterialRow]) -> list[PaintInput]:
    """The paint of each painted material."""
    rows = {row.name: row for row in materials}
    return [
        PaintInput(
            material=name,
            mean=float(np.dot(LUMINANCE, rows[name].color)),
            color=None if (color := coats[k].color) is None else linear_color(color),
            hue=coats[k].hue_deg / 360.0,
            saturation=coats[k].saturation,
            value=coats[k].value,
            keeps_dark=rows[name].keeps_dark,
            everywhere=bool(rows[name].left_alone),
        )
        for name, k in painted(materials, [coat.materials for coat in coats]).items()
    ]


Asset = TypeVar("Asset")


def _named(known: Mapping[str, Asset], name: str, kind: str, row: Row) -> Asset:
    if name not in known:
        raise ConfigError(
            f"image {row.index}: {kind} {name!r} is not among {sorted(known)}",
            remedy="plan again with `hulldown plan`",
        )
    return known[name]
