"""From a plan's rows to what a worker is told: absolute paths, matrices and numbers, nothing to look up."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from assets.vehicle import VehicleShape
from camera.projection import NEAR
from geometry.errors import ConfigError

PREPARED = 1  # version of what render.prepare writes


@dataclass(frozen=True, eq=False, slots=True)
class VehicleFile:
    """A vehicle's file, its shape, and its entry in the config."""

    path: Path
    shape: VehicleShape
    entry: Mapping[str, Any]

    def prepared(self, cache: Path, blender: str | None) -> Path:
        """Where the file that `render.prepare` makes of it is kept; another name when anything has changed."""
        what = [
            PREPARED,
            blender,
            str(self.path),
            hashlib.sha256(self.path.read_bytes()).hexdigest(),
            dict(self.entry),
            self.shape.vehicle_from_file.tolist(),
        ]
        return cache / f"{self.path.stem}-{hashlib.sha256(json.dumps(what).encode()).hexdigest()[:16]}.blend"


@dataclass(frozen=True, eq=False, slots=True)
class SceneryFile:
    """A scenery's file and where its coordinates go."""

    path: Path
    scenery_from_file: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, eq=False, slots=True)
class RenderAssets:
    """The files a plan is rendered from, by the names the plan uses."""

    vehicles: Mapping[str, VehicleFile]
    sceneries: Mapping[str, SceneryFile]
    hdris: Mapping[str, Path]


def targets(row: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The vehicles of a row, the one it is about first."""
    return [row, *row["companions"]]


def job(
    row: Mapping[str, Any],
    assets: RenderAssets,
    prepared: Mapping[str, Path],
    settings: Mapping[str, Any],
    output: Path,
) -> dict[str, Any]:
    """What to tell a worker for one row.

    Parameters
    ----------
    row
        A row of the plan.
    assets, prepared
        The files, and for each vehicle what was made of its file.
    settings
        See `render.cycles.configure`.
    output
        Where the worker shall write.

    Raises
    ------
    ConfigError
        If the row names an asset that the plan's header does not.
    """
    scenery = _named(assets.sceneries, row["scenery"], "scenery", row)
    weather = row["weather"] or {}
    return {
        "do": "render",
        "scenery": {"path": str(scenery.path), "scenery_from_file": scenery.scenery_from_file.tolist()},
        "vehicles": [_vehicle(target, assets, prepared, row) for target in targets(row)],
        "camera": {
            "world_from_camera": row["world_from_camera"],
            "fov_x": math.radians(row["fov_x_deg"]),
            "width": row["width"],
            "height": row["height"],
            "near": NEAR,
        },
        "light": {
            "hdri": str(_named(assets.hdris, row["hdri"], "hdri", row)),
            "yaw": math.radians(row["hdri_yaw_deg"]),
            "strength": row["strength"],
            "visibility": weather.get("visibility_m"),
        },
        "seed": int(row["sample_seed"]) % 2**31,
        "settings": dict(settings),
        "output": str(output),
    }


def _vehicle(
    target: Mapping[str, Any], assets: RenderAssets, prepared: Mapping[str, Path], row: Mapping[str, Any]
) -> dict[str, Any]:
    shape = _named(assets.vehicles, target["vehicle"], "vehicle", row).shape
    world_from_vehicle = np.array(target["world_from_vehicle"], dtype=np.float64)
    parts = world_from_vehicle @ shape.vehicle_from_parts(target["articulation"])
    return {"prepared": str(prepared[target["vehicle"]]), "world_from_parts": parts.tolist()}


def _named(known: Mapping[str, Any], name: str, kind: str, row: Mapping[str, Any]) -> Any:
    if name not in known:
        raise ConfigError(
            f"image {row['index']}: {kind} {name!r} is not among {sorted(known)}",
            remedy="plan again with `hulldown plan`",
        )
    return known[name]
