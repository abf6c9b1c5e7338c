"""The config: every section, key, range, and default.

References
----------
Paper, sections 2.1.1 to 2.1.8, for what the keys mean and for the defaults.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from hulldown.base.toml_files import read_toml, validated
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.response import COOLEST, FARTHEST_EV, WARMEST
from hulldown.geometry.arrays import are_numbers
from hulldown.planning.config.asset_sections import AssetsSection
from hulldown.planning.config.paint_section import PaintEntry
from hulldown.planning.config.section import AtLeastZero, Pair, Patterns, Section, Share, is_absent, ranged, with_preset
from hulldown.planning.config.sensor_section import SensorSection
from hulldown.planning.config.weather_section import WeatherSection

MOST_IMAGES = 1_000_000_000  # of a class
LARGEST = 65536  # pixels of a side
LIKE_SHARE, LIKE_SPREAD = 0.7, 0.2


def _exposure(value: Any) -> str | float:
    """Check "auto" or a number of EV."""
    if value == "auto":
        return "auto"
    if are_numbers([value]) and abs(value) <= FARTHEST_EV:
        return float(value)
    raise ValueError(f"expected 'auto' or EV from {-FARTHEST_EV:g} to {FARTHEST_EV:g}")


def _per_class(value: object) -> object:
    """Check a number of images for every class, or a table of numbers by class."""
    counts = list(value.values()) if isinstance(value, dict) else [value]
    if value is not None and any(type(n) is not int or not 0 <= n <= MOST_IMAGES for n in counts):
        raise ValueError(f"expected a whole number from 0 to {MOST_IMAGES}, or a table of them by class")
    return value


Fractions = Annotated[Pair, ranged(0.0, 1.0)]
Lengths = Annotated[Pair, ranged(0.0, 1e6)]
Exposure = Annotated[Literal["auto"] | float, BeforeValidator(_exposure)]
PerClass = Annotated[int | dict[str, int] | None, BeforeValidator(_per_class)]


class GroundSection(Section):
    """Which objects are ground in all sceneries, by name (paper, section 2.1.5)."""

    include: Patterns = ()
    """patterns of objects that are ground"""
    exclude: Patterns = ()
    """patterns of objects that aren't ground"""
    fallback_z: float = 0.0
    """height of the plane that replaces missing ground, meters"""


class PlacementSection(Section):
    """Where vehicles are placed (paper, section 2.1.5)."""

    margin: float = Field(default=0.8, gt=0, le=1)
    """middle share of the scenery's extent in which targets are placed"""
    max_slope_deg: float = Field(default=30.0, ge=0, lt=90)
    """steepest ground under the vehicle's origin and the whole vehicle"""
    rule: Literal["averaged", "least_squares", "support"] = "support"
    """how the resting plane is found ("averaged": the paper)"""
    contact: Literal["footprint", "box"] = "footprint"
    """what touches the ground: "footprint", tracks, wheels, and belly; "box", as in the paper, a plate under the
    bounding box"""
    footprint: int = Field(default=5, ge=2, le=101)
    """n x n rays are cast under the vehicle"""
    min_valid_share: float = Field(default=0.8, gt=0, le=1)
    """least share of these rays that must meet ground"""
    max_gap: AtLeastZero = 1.0
    """meters of air under wheels and tracks, at most"""
    max_penetration: AtLeastZero = 0.3
    """meters of ground above the underside, at most"""
    fording_depth: AtLeastZero = 0.0
    """meters of water above the underside, at most"""
    obstacle_clearance: AtLeastZero = 0.5
    """meters between vehicles and obstacles, at least"""
    indoors: bool = Field(default=False, exclude_if=(False).__eq__)
    """also places that no light of the sky reaches: halls and caves"""
    vehicle_clearance: AtLeastZero = 2.0
    """meters between vehicles, at least"""
    vehicles_per_image: Annotated[tuple[int, int], ranged(1.0, 64.0, int)] = (1, 1)
    """the target and companions; budgets count targets only"""
    companion_distance: Lengths = (8.0, 40.0)
    """meters from the target to a companion"""
    distractors_per_image: Annotated[tuple[int, int], ranged(0.0, 64.0, int)] = (0, 3)
    """distractors in an image, if the scenery has any"""
    distractor_distance: Lengths = (0.0, 40.0)
    """meters from the target to a distractor, uniform by area"""
    articulate: bool = True
    """turn turrets and raise guns"""
    max_tries: int = Field(default=10_000, ge=1, le=1_000_000)
    """places tried for a position"""


class CameraMatrix(Section):
    """OpenCV's camera matrix K, in pixels."""

    fx: float = Field(gt=0, le=1e9)
    fy: float = Field(gt=0, le=1e9)
    cx: float = Field(ge=-1e9, le=1e9)
    cy: float = Field(ge=-1e9, le=1e9)


class Distortion(Section):
    """The coefficients of a lens's distortion, with OpenCV's names and signs."""

    k1: float = Field(default=0.0, ge=-1e6, le=1e6)
    k2: float = Field(default=0.0, ge=-1e6, le=1e6)
    p1: float = Field(default=0.0, ge=-1e6, le=1e6)
    p2: float = Field(default=0.0, ge=-1e6, le=1e6)
    k3: float = Field(default=0.0, ge=-1e6, le=1e6)


class CameraSection(Section):
    """Where cameras are placed and what they must see (paper, section 2.1.6)."""

    fov_x_deg: Annotated[Pair, ranged(0.1, 179.0)] = (40.0, 60.0)
    """horizontal field of view, degrees"""
    intrinsics: CameraMatrix | None = Field(
        default=None, examples=[{"fx": 1420.0, "fy": 1418.5, "cx": 964.2, "cy": 545.7}], exclude_if=is_absent
    )
    """a calibrated camera's focal lengths and principal point, in pixels from the first pixel's corner: OpenCV's K,
    with 0.5 added to cx and cy; replaces fov_x_deg"""
    distortion: Distortion | None = Field(
        default=None, examples=[{"k1": -0.21, "k2": 0.07, "p1": 0.0003, "p2": -0.0001, "k3": 0.0}], exclude_if=is_absent
    )
    """its lens distortion (OpenCV's Brown-Conrady); needs intrinsics"""
    roll_deg: Annotated[Pair, ranged(-180.0, 180.0)] = Field(default=(0.0, 0.0), exclude_if=is_absent)
    """turn about the optical axis, degrees; positive lowers the right side"""
    size_measure: Literal["paper", "height", "width", "diagonal", "area"] = "paper"
    """what target_fraction measures: "paper", the vehicle's smallest dimension; else the projected box"""
    target_fraction: Annotated[Pair, ranged(1e-4, 10.0)] = (0.1, 0.3)
    """share of the image that the target fills"""
    distance_factor: Annotated[Pair, ranged(1e-3, 1e3)] = (0.7, 4.0)
    """factor on equation 6's distance; with size_measure = "paper" only"""
    distance_m: Lengths = (2.0, 5000.0)
    """bounds on meters from target to camera"""
    elevation_deg: Annotated[Pair, ranged(-90.0, 90.0)] = (3.0, 35.0)
    """camera's angle above the target's horizon, degrees"""
    elevation_sampling: Literal["angle", "sphere"] = "angle"
    """"angle": uniform in degrees; "sphere": uniform on the shell's area"""
    framing: Share = 0.8
    """0 centers the target; 1 lets it be anywhere in the frame"""
    ground_clearance: AtLeastZero = 0.5
    """meters above ground and water, at least"""
    obstacle_clearance: AtLeastZero = 1.0
    """meters to obstacles and vehicles, at least"""
    visible_fraction: Fractions = (0.3, 1.0)
    """unhidden share of the target's outline"""
    visibility_rays: int = Field(default=256, ge=1, le=1_000_000)
    """rays that measure visible_fraction"""
    truncated_fraction: Fractions = (0.0, 0.0)
    """share of the target's box that the frame cuts off"""
    min_box_px: AtLeastZero = 8.0
    """least width and height of the target's box, pixels"""
    max_tries: int = Field(default=50, ge=1, le=10_000)
    """cameras tried for an image before the vehicle is moved"""
    like: str | None = Field(default=None, min_length=1, examples=["photographs/train"], exclude_if=is_absent)
    """photographs whose boxes targets follow: a COCO file, or a folder of COCO, YOLO, or VOC"""
    like_share: Share = Field(default=LIKE_SHARE, exclude_if=LIKE_SHARE.__eq__)
    """share of images that follow photographs"""
    like_spread: float = Field(default=LIKE_SPREAD, ge=0, le=0.9, exclude_if=LIKE_SPREAD.__eq__)
    """largest deviation from the photograph's box, relative to its size"""


Lines = Annotated[tuple[Annotated[tuple[str, str], Field(strict=False)], ...], Field(strict=False)]


class AnnotateSection(Section):
    """The least that a labeled vehicle must show; by default, the camera's limits for targets apply."""

    min_box_px: AtLeastZero | None = Field(default=None, examples=[8.0])
    """least width and height of its box, pixels; default: camera.min_box_px"""
    min_visible_fraction: Share | None = Field(default=None, examples=[0.3])
    """least unhidden share; default: the least camera.visible_fraction"""
    max_truncated_fraction: Share | None = Field(default=None, examples=[0.8])
    """largest share of its box that the frame cuts off; default: 0.8, or the largest camera.truncated_fraction if
    that's more"""
    below: Literal["ignored", "left_out"] = "ignored"
    """vehicles that show less get a label with iscrowd = 1 ("ignored") or none ("left_out")"""
    keypoints: Patterns | None = Field(default=None, examples=[["*"]], exclude_if=is_absent)
    """patterns of the keypoints to label, such as muzzle and wheel_*; default: none"""
    skeleton: Lines | None = Field(default=None, examples=[[["muzzle", "turret"]]], exclude_if=is_absent)
    """pairs of keypoints to join; default: muzzle to turret, and wheel to wheel"""


class BudgetSection(Section):
    """How many images: per class (paper, section 2.1.8), or by positions per vehicle (equation 1)."""

    images_per_class: PerClass = Field(default=None, examples=[140])
    """a number, or a table such as { tank = 200, truck = 100 }; a class's models take turns"""
    positions_per_vehicle: int | None = Field(default=None, ge=0, le=MOST_IMAGES, examples=[28])
    """instead: vehicles x positions x images_per_position images (equation 1)"""
    images_per_position: int = Field(default=5, ge=1, le=1_000_000)
    """images of each position"""
    background_share: float = Field(default=0.0, ge=0, le=0.99)
    """share of images without a target, added to those above"""
    background_distractors: Share = 0.5
    """share of background positions where a distractor replaces the target"""

    @model_validator(mode="after")
    def _one_of_two(self) -> BudgetSection:
        if (self.images_per_class is None) == (self.positions_per_vehicle is None):
            raise ValueError("expected exactly one of images_per_class and positions_per_vehicle")
        return self


class HdriChoice(Section):
    """A pattern of HDRI names, and how often these HDRIs are drawn."""

    name: str
    weight: AtLeastZero = 1.0


def _choice(value: object) -> object:
    if not isinstance(value, (str, dict, HdriChoice)):
        raise ValueError("expected a name or { name = ..., weight = ... }")
    return {"name": value} if isinstance(value, str) else value


class LightSection(Section):
    """HDRIs, their rotation, strength, and visible part, and the exposure of the camera."""

    hdris: Annotated[tuple[Annotated[HdriChoice, BeforeValidator(_choice)], ...], Field(strict=False)] = ()
    """patterns of HDRIs, or { name = "noon*", weight = 2.0 }; empty: all, equally often"""
    yaw_deg: Annotated[Pair, ranged(-360.0, 360.0)] = (0.0, 360.0)
    """turn of the HDRI, degrees"""
    strength: Annotated[Pair, ranged(0.0, 1e9)] = (0.7, 1.3)
    """factor on the HDRI's brightness; exposure = "auto" compensates for it"""
    backdrop: Literal["auto", "hdri", "sky"] = "auto"
    """what the camera sees of the HDRI: "hdri", all; "sky", above its horizon; "auto", "sky" if it shows land"""
    exposure: Exposure = "auto"
    """"auto": a gray card on open land comes out mid-gray; or EV for all images"""
    exposure_error_ev: Annotated[Pair, ranged(-10.0, 10.0)] = (-1.0, 1.0)
    """error of the exposure, EV"""
    white_balance_error_k: Annotated[Pair, ranged(COOLEST, WARMEST)] = (0.0, 0.0)
    """white balance minus 6500 K; more is warmer"""
    overcast: Patterns = ()
    """patterns of HDRIs for rain and snow; empty: as for other weather"""


PROFILES: Mapping[str, Mapping[str, object]] = {
    "paper": {"samples": 128, "denoise": True, "adaptive_threshold": 0.0, "bounces": 12},
    "fast": {"samples": 32, "denoise": True, "adaptive_threshold": 0.05, "bounces": 4},
    "train": {"samples": 8, "denoise": True, "adaptive_threshold": 0.05, "bounces": 4},
}


class RenderSection(Section):
    """Cycles' settings (paper, section 2.1.4); a profile gives defaults for some of them."""

    profile: Literal["paper", "fast", "train"] = "paper"
    """sets the last four keys; "fast" is for a look, "train" for many images in little time"""
    width: int = Field(default=1920, ge=1, le=LARGEST)
    """pixels"""
    height: int = Field(default=1080, ge=1, le=LARGEST)
    """pixels"""
    samples: int = Field(default=128, ge=1, le=1_000_000)
    """rays per pixel"""
    denoise: bool = True
    """OpenImageDenoise"""
    adaptive_threshold: Share = 0.0
    """noise at which a pixel gets no more samples; 0: off"""
    bounces: int = Field(default=12, ge=0, le=1024)
    """light bounces"""

    @model_validator(mode="before")
    @classmethod
    def _profile_first(cls, data: object) -> object:
        return with_preset(data, "profile", PROFILES)


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
    sensor: SensorSection = Field(default=SensorSection(), exclude_if=SensorSection().__eq__)
    render: RenderSection = RenderSection()

    @model_validator(mode="after")
    def _camera_is_possible(self) -> Config:
        if self.camera.distortion is not None and self.camera.intrinsics is None:
            raise ValueError("camera.distortion: expected camera.intrinsics beside it: a calibration gives both")
        try:
            self.calibrated  # noqa: B018  # a lens that folds is refused
        except ValueError as error:
            raise ValueError(f"camera.{error}") from None
        return self

    @property
    def calibrated(self) -> Intrinsics | None:
        """The calibrated camera of all images; None if their fields of view are drawn."""
        camera, render = self.camera, self.render
        if camera.intrinsics is None:
            return None
        lens = camera.distortion or Distortion()
        matrix = tuple(camera.intrinsics.model_dump().values())
        return Intrinsics.calibrated(render.width, render.height, matrix, tuple(lens.model_dump().values()))

    def intrinsics(self, fov_x_deg: np.ndarray) -> Intrinsics:
        """Return the calibrated camera, or cameras with these fields of view (n,)."""
        return self.calibrated or Intrinsics(self.render.width, self.render.height, np.radians(fov_x_deg))

    @model_validator(mode="after")
    def _targets_are_labeled(self) -> Config:
        """Refuse limits of labels that a target could fail."""
        given, camera = self.annotate, self.camera
        for key, limit, source in (
            ("min_box_px", camera.min_box_px, "at most camera.min_box_px"),
            ("min_visible_fraction", camera.visible_fraction[0], "at most the least camera.visible_fraction"),
            ("max_truncated_fraction", camera.truncated_fraction[1], "at least the largest camera.truncated_fraction"),
        ):
            value = getattr(given, key)
            if value is not None and (value < limit if key.startswith("max") else value > limit):
                raise ValueError(
                    f"annotate.{key} = {value:g}: expected {source}, {limit:g}, since every target has a label"
                )
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
        config = validated(cls, sections, path)
        config._path = path
        return config

    def paint_of(self, vehicle: str) -> tuple[PaintEntry, ...]:
        """Return the paint of the vehicle or distractor of this name; empty for an unknown name."""
        entries = (*self.assets.vehicles, *self.assets.distractors)
        return next((entry.paint for entry in entries if entry.name == vehicle), ())

    _path: Path | None = PrivateAttr(default=None)

    @property
    def path(self) -> Path | None:
        """The file that the config was read from, if any."""
        return self._path

    @property
    def folder(self) -> Path:
        """The folder that relative paths in the config start from."""
        return self._path.parent if self._path is not None else Path()
