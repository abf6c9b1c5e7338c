"""The config (paper, sections 2.1.1 to 2.1.8): all its sections, its file, and what they imply together."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from hulldown.base.errors import ConfigError
from hulldown.base.toml_files import read_toml, validate_model
from hulldown.camera.intrinsics import Intrinsics
from hulldown.plan.config.asset_sections import AssetsSection, PaintEntry
from hulldown.plan.config.scene_sections import (
    AnnotateSection,
    BudgetSection,
    CameraSection,
    Distortion,
    GroundSection,
    LightSection,
    PlacementSection,
    RenderSection,
    WeatherSection,
)
from hulldown.plan.config.section import Section

if TYPE_CHECKING:
    from hulldown.plan.lines import PlanFile


# What to use instead of keys and values of earlier versions.
REMOVED_KEYS = MappingProxyType(
    {
        "sensor": "`train` adds blur, noise, and compression (docs/training.md)",
        "assets.sceneries.buildings": "model them in Blender, or import them there by BlenderGIS, and list the .blend",
        "ground.include": "name what is ground in the `ground` of each scenery",
        "ground.exclude": "name what isn't ground in the `not_ground` of each scenery",
        "placement.contact": "tracks, wheels, and belly touch the ground",
        "placement.footprint": "5 x 5 rays are cast under a vehicle",
        "placement.min_valid_share": "80 % of the rays under a vehicle must meet ground",
        "placement.rule = 'least_squares'": 'use "support", which is nearer to the resting pose',
        **{
            f"assets.{kind}.{key}": instead
            for kind in ("vehicles", "distractors")
            for key, instead in {
                "yaw_deg": "`forward` may be any number of degrees",
                **dict.fromkeys(("paint.hue_deg", "paint.saturation", "paint.value"), "list the `colors` to draw from"),
            }.items()
        },
    }
)


class Config(Section):
    """A whole config; see docs/config.md for every key.

    Examples
    --------
    >>> config = Config.of(
    ...     {
    ...         "assets": {
    ...             "vehicles": [{"path": "tank.blend", "category": "tank"}],
    ...             "sceneries": [{"path": "hills.blend"}],
    ...         },
    ...         "budget": {"images_per_class": 100},
    ...     }
    ... )
    >>> config.camera.fov_x_deg
    (40.0, 60.0)
    """

    seed: int = Field(default=0, ge=0, lt=2**63)
    """seed of all random draws"""
    assets: AssetsSection
    ground: GroundSection = GroundSection()
    placement: PlacementSection = PlacementSection()
    camera: CameraSection = CameraSection()
    annotate: AnnotateSection = AnnotateSection()
    budget: BudgetSection
    light: LightSection = LightSection()
    weather: WeatherSection = WeatherSection()
    render: RenderSection = RenderSection()
    _path: Path | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _refuse_impossible_camera(self) -> Config:
        if self.camera.distortion is not None and self.camera.intrinsics is None:
            raise ValueError("camera.distortion: expected camera.intrinsics beside it: a calibration gives both")
        try:
            self.calibrated_intrinsics  # noqa: B018  # a lens that folds is refused
        except ValueError as error:
            raise ValueError(f"camera.{error}") from None
        return self

    @model_validator(mode="after")
    def _refuse_unlabeled_targets(self) -> Config:
        given, camera = self.annotate, self.camera
        for key, limit, source in (
            ("min_box_px", camera.min_box_px, "at most camera.min_box_px"),
            ("min_visible_fraction", camera.visible_fraction[0], "at most the least camera.visible_fraction"),
            ("max_truncated_fraction", camera.truncated_fraction[1], "at least the largest camera.truncated_fraction"),
        ):
            value = getattr(given, key)
            if value is not None and (value < limit if key.startswith("max") else value > limit):
                raise ValueError(f"annotate.{key} = {value:g}: expected {source}, {limit:g}, since every target has a label")
        return self

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Config:
        """Return the config in a TOML file, complete with defaults.

        Raises
        ------
        ConfigError
            Naming file, key, value and what is allowed.
        """
        path = Path(path)
        return cls.of(read_toml(path, remedy="`hulldown init` writes one to start from"), path=path)

    @classmethod
    def of(cls, sections: Mapping[str, object], *, path: Path | None = None) -> Config:
        """Return the config in nested dictionaries, such as those of TOML or of a plan's header.

        Parameters
        ----------
        sections
            The keys and values of a config file, from "seed" and the names of sections on.
        path
            The file they come from. Paths in the config are relative to its folder; None: to the current one.

        Raises
        ------
        ConfigError
            Naming file, key, value and what is allowed.
        """
        config = validate_model(cls, sections, path, removed=REMOVED_KEYS)
        config._path = path
        return config

    @classmethod
    def of_plan(cls, plan: PlanFile) -> Config:
        """Return the config in a plan's header, with the folder that the header names."""
        root = Path(os.path.normpath(plan.path.absolute().parent / plan.header.root))
        try:
            return cls.of(plan.header.config, path=root / plan.path.name)
        except ConfigError as error:
            problem, remedy = f"line 1, config: {error.problem}", "plan again with `hulldown plan`"
            raise ConfigError(problem, path=plan.path, remedy=remedy) from None

    @property
    def path(self) -> Path | None:
        """The file that the config was read from, if any."""
        return self._path

    @property
    def folder(self) -> Path:
        """The folder that relative paths in the config start from."""
        return self._path.parent if self._path is not None else Path()

    @property
    def calibrated_intrinsics(self) -> Intrinsics | None:
        """The calibrated camera of all images; None if their fields of view are drawn."""
        camera, render = self.camera, self.render
        if camera.intrinsics is None:
            return None
        lens = camera.distortion or Distortion()
        matrix = tuple(camera.intrinsics.model_dump().values())
        return Intrinsics.calibrated(render.width, render.height, matrix, tuple(lens.model_dump().values()))

    def intrinsics(self, fov_x_deg: np.ndarray) -> Intrinsics:
        """Return the calibrated camera, or cameras with these fields of view (n,)."""
        return self.calibrated_intrinsics or Intrinsics(self.render.width, self.render.height, np.radians(fov_x_deg))

    def vehicle_paint(self, vehicle: str) -> tuple[PaintEntry, ...]:
        """Return the paint of the vehicle or distractor with this name; empty for an unknown name."""
        entries = (*self.assets.vehicles, *self.assets.distractors)
        return next((entry.paint for entry in entries if entry.name == vehicle), ())
