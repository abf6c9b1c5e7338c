"""Turn a plan's rows into self-contained jobs for workers: absolute paths, matrices, and numbers."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from msgspec import structs

from hulldown.base.color import linear_rgb_from_hex
from hulldown.base.errors import ConfigError
from hulldown.camera.cameras import NEAR_M
from hulldown.plan.coats import Coat, color_of_material
from hulldown.plan.library import Library
from hulldown.plan.plan_file import Plan
from hulldown.plan.row import PlannedVehicle, Row
from hulldown.reading.confinement.landlock import readable_asset_folders
from hulldown.reading.pieces.asset_report import MaterialRow
from hulldown.render.blender.messages import CameraInput, CyclesSettings, LightInput, MaskJob, RenderJob, VehicleInput


def blender_readable_paths(library: Library) -> tuple[Path, ...]:
    """Return the paths that Blender may read, by the config alone: folders of its files and their twins, and HDRIs."""
    read = (*library.models.values(), *library.sceneries.values())
    files = [file for exported in read for file in (exported.tidy, exported.report.path)]
    folders = [folder for file in files for folder in readable_asset_folders(Path(os.path.normpath(file)))]
    return tuple(dict.fromkeys([*folders, *(hdri.path for hdri in library.hdris.values())]))


def make_planned_row_job(plan: Plan, row: Row, library: Library, output: Path) -> RenderJob:
    """Return the job of rendering a row with the settings of its plan."""
    chosen = plan.config.render
    settings = CyclesSettings(chosen.samples, chosen.denoise, chosen.adaptive_threshold, chosen.bounces)
    try:
        return make_render_job(row, library, settings, output)
    except ValueError as error:  # errors beyond the schema, such as a vehicle's unknown part
        problem = f"line {row.index + 2} cannot be rendered ({error})"
        raise ConfigError(problem, path=plan.path, remedy="plan again with `hulldown plan`") from error


def make_render_job(row: Row, library: Library, settings: CyclesSettings, output: Path) -> RenderJob:
    """Return the job of rendering a row."""
    return RenderJob(
        scenery=_scenery_twin_path(row, library),
        vehicles=[_vehicle_input(vehicle, library, row) for vehicle in row.vehicles],
        camera=_camera_input(row),
        light=LightInput(
            hdri=str(_require_named_asset(library.hdris, row.hdri, "hdri", row).path.resolve()),
            yaw=math.radians(row.hdri_yaw_deg),
            strength=row.strength,
            horizon=None if row.horizon_deg is None else math.radians(row.horizon_deg),
        ),
        weather=row.weather,
        seed=row.sample_seed % 2**31,
        settings=settings,
        output=str(output),
    )


def make_mask_job(row: Row, library: Library, output: Path) -> MaskJob:
    """Return the job of rendering a row's masks; parameters and errors as for `make_render_job`."""
    vehicles = [_vehicle_input(structs.replace(vehicle, paint=[]), library, row) for vehicle in row.vehicles]
    return MaskJob(scenery=_scenery_twin_path(row, library), vehicles=vehicles, camera=_camera_input(row), output=str(output))


def _scenery_twin_path(row: Row, library: Library) -> str:
    return str(_require_named_asset(library.sceneries, row.scenery, "scenery", row).tidy.resolve())


def _camera_input(row: Row) -> CameraInput:
    return CameraInput(
        world_from_camera=row.world_from_camera.tolist(),
        intrinsics=row.intrinsics,
        near=NEAR_M,
        exposure=row.exposure_ev,
        white_balance=row.white_balance_k,
    )


def _vehicle_input(vehicle: PlannedVehicle, library: Library, row: Row) -> VehicleInput:
    shape = _require_named_asset(library.shapes, vehicle.vehicle, "vehicle", row)
    exported = library.models[vehicle.vehicle]
    parts = vehicle.world_from_vehicle @ shape.vehicle_from_parts(vehicle.articulation)
    return VehicleInput(
        str(exported.tidy.resolve()), parts.tolist(), _linear_paint_by_material(vehicle.paint, exported.report.materials)
    )


def _linear_paint_by_material(coats: Sequence[Coat], materials: Sequence[MaterialRow]) -> dict[str, tuple[float, float, float]]:
    colors = {row.name: color_of_material(row.name, coats) for row in materials}
    return {name: linear_rgb_from_hex(color) for name, color in colors.items() if color is not None}


Asset = TypeVar("Asset")


def _require_named_asset(known: Mapping[str, Asset], name: str, kind: str, row: Row) -> Asset:
    if name not in known:
        raise ConfigError(
            f"image {row.index}: {kind} {name!r} is not among {sorted(known)}", remedy="plan again with `hulldown plan`"
        )
    return known[name]
