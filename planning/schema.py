"""What a config may say: every section, key, range and default.

References
----------
Paper, sections 2.1.1 to 2.1.8, for what the keys mean and for the defaults.
"""

from __future__ import annotations

import fnmatch
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from assets.textures import TEXTURE_SIZE
from camera.response import COOLEST, FARTHEST_EV, WARMEST
from planning.paint import Paint, PaintEntry
from planning.section import Section
from planning.section import ranged as _range
from planning.weather_section import WeatherSection

CACHE_NAME = ".hulldown-cache"
MOST_IMAGES = 1_000_000_000  # of a class


def _forward(value: Any) -> str | float | Pair | None:
    """An axis, an angle in degrees, or a vector that is not upright."""
    if value is None or (isinstance(value, str) and value in ("+x", "-x", "+y", "-y")):
        return value
    if _numbers([value]) and -360 <= value <= 360:
        return float(value)
    if isinstance(value, (list, tuple)) and len(value) in (2, 3) and _numbers(value) and any(value[:2]):
        return float(value[0]), float(value[1])
    raise ValueError("expected '+x', '-x', '+y', '-y', degrees from -360 to 360, or a vector [x, y]")


def _exposure(value: Any) -> str | float:
    """By the light, or a number of EV."""
    if value == "auto":
        return "auto"
    if _numbers([value]) and abs(value) <= FARTHEST_EV:
        return float(value)
    raise ValueError(f"expected 'auto' or EV from {-FARTHEST_EV:g} to {FARTHEST_EV:g}")


def _pivot(value: Any) -> str | tuple[float, ...] | None:
    """The name of an object, or a point of the file."""
    if value is None or (isinstance(value, str) and value):
        return value
    if isinstance(value, (list, tuple)) and len(value) == 3 and _numbers(value):
        return tuple(float(x) for x in value)
    raise ValueError("expected the name of an object, or [x, y, z] in the file's axes and units")


def _numbers(values: Sequence[Any]) -> bool:
    # NaN fails the comparison, and so do integers that are no float.
    return all(isinstance(x, (int, float)) and not isinstance(x, bool) and abs(x) <= sys.float_info.max for x in values)


def _per_class(value: Any) -> Any:
    """A number of images for every class, or a table of them by class."""
    counts = list(value.values()) if isinstance(value, dict) else [value]
    if value is not None and any(type(n) is not int or not 0 <= n <= MOST_IMAGES for n in counts):
        raise ValueError(f"expected a whole number from 0 to {MOST_IMAGES}, or a table of them by class")
    return value


Pair = tuple[float, float]
Fractions = Annotated[Pair, _range(0.0, 1.0)]
TargetFractions = Annotated[Pair, _range(1e-4, 10.0)]
Factors = Annotated[Pair, _range(1e-3, 1e3)]
Lengths = Annotated[Pair, _range(0.0, 1e6)]
Strengths = Annotated[Pair, _range(0.0, 1e9)]
Degrees = Annotated[Pair, _range(-360.0, 360.0)]
TurretLimits = Annotated[Pair | None, _range(-360.0, 360.0, optional=True)]
GunLimits = Annotated[Pair | None, _range(-90.0, 90.0, optional=True)]
Elevations = Annotated[Pair, _range(-90.0, 90.0)]
FieldsOfView = Annotated[Pair, _range(0.1, 179.0)]
Exposure = Annotated[Literal["auto"] | float, BeforeValidator(_exposure)]
ExposureErrors = Annotated[Pair, _range(-10.0, 10.0)]
Kelvins = Annotated[Pair, _range(COOLEST, WARMEST)]
Counts = Annotated[tuple[int, int], _range(1.0, 64.0, int)]
CountsFromZero = Annotated[tuple[int, int], _range(0.0, 64.0, int)]
Forward = Annotated[str | float | Pair | None, BeforeValidator(_forward)]
PivotPoint = Annotated[str | tuple[float, float, float] | None, BeforeValidator(_pivot)]
Patterns = Annotated[tuple[str, ...], Field(strict=False)]
Positive = Annotated[float, Field(gt=0)]
AtLeastZero = Annotated[float, Field(ge=0)]
PerClass = Annotated[int | dict[str, int] | None, BeforeValidator(_per_class)]


class ModelEntry(Section):
    """A file, and what in it is the vehicle."""

    path: str
    name: str = ""
    forward: Forward = None
    yaw_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    up: Literal["z", "-z", "y", "-y", "x", "-x"] | None = None
    scale: Positive | None = None
    keep: Patterns = ()
    drop: Patterns = ()
    turret: str | None = None
    gun: str | None = None
    turret_pivot: PivotPoint = None
    gun_pivot: PivotPoint = None
    turret_limits_deg: TurretLimits = None
    gun_limits_deg: GunLimits = None
    paint: Paint = ()
    sceneries: Patterns = ()

    def is_for(self, scenery: str) -> bool:
        """Whether it may be placed on the scenery of this name."""
        return not self.sceneries or any(fnmatchcase(scenery, pattern) for pattern in self.sceneries)


class VehicleEntry(ModelEntry):
    """One `[[assets.vehicles]]`: a model and its class."""

    category: str = Field(min_length=1)


class DistractorEntry(ModelEntry):
    """One `[[assets.distractors]]`: a model that is no target, where it occurs and how often; a class if it has one."""

    category: str | None = Field(default=None, min_length=1)
    weight: AtLeastZero = 1.0
    sceneries: Patterns = ()


class SceneryEntry(Section):
    """One `[[assets.sceneries]]`: a .blend file, what in it is what, and how often it is drawn beside the others."""

    path: str
    name: str = ""
    up: Literal["z", "y"] | None = None
    scale: Positive | None = None
    ground: Patterns = ()
    not_ground: Patterns = ()
    water: Patterns | None = None
    drop: Patterns = ()
    weight: AtLeastZero = 1.0


class AssetsSection(Section):
    """Files to read; paths are relative to the config's folder."""

    cache: str = CACHE_NAME
    texture_size: Annotated[int, Field(ge=1, le=16384)] = TEXTURE_SIZE
    hdris: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = ("hdris/*.exr",)
    vehicles: Annotated[tuple[VehicleEntry, ...], Field(strict=False, min_length=1)]
    sceneries: Annotated[tuple[SceneryEntry, ...], Field(strict=False, min_length=1)]
    distractors: Annotated[tuple[DistractorEntry, ...], Field(strict=False)] = ()

    @property
    def entries(self) -> tuple[VehicleEntry | DistractorEntry | SceneryEntry, ...]:
        """All that is listed with a file of its own."""
        return (*self.vehicles, *self.distractors, *self.sceneries)

    @model_validator(mode="before")
    @classmethod
    def _name_by_file(cls, data: Any) -> Any:
        """An entry without a name is called as its file."""
        if not isinstance(data, dict):
            return data
        named = dict(data)
        for kind in ("vehicles", "sceneries", "distractors"):
            entries = data.get(kind)
            if isinstance(entries, (list, tuple)):
                named[kind] = [
                    {**e, "name": e.get("name") or _stem(e["path"])}
                    if isinstance(e, dict) and isinstance(e.get("path"), str)
                    else e
                    for e in entries
                ]
        return named

    @model_validator(mode="after")
    def _names_are_unique(self) -> AssetsSection:
        vehicles = "vehicles and distractors" if self.distractors else "vehicles"
        for kind, names in (
            (vehicles, [entry.name for entry in (*self.vehicles, *self.distractors)]),
            ("sceneries", [entry.name for entry in self.sceneries]),
        ):
            for name, count in Counter(names).items():
                if count > 1:
                    raise ValueError(f"{count} {kind} are called {name!r}; give each its own `name`")
        known = [entry.name for entry in self.sceneries]
        for entry in self.distractors:
            if unknown := [pattern for pattern in entry.sceneries if not fnmatch.filter(known, pattern)]:
                raise ValueError(f"distractor {entry.name!r}: sceneries: {unknown[0]!r} matches none of {known}")
        if not any(e.weight for e in self.sceneries):
            raise ValueError("all sceneries have weight 0; expected at least one above 0")
        return self


def _stem(path: str) -> str:
    return (PureWindowsPath(path) if "\\" in path else PurePosixPath(path)).stem


class GroundSection(Section):
    """Which objects are ground in all sceneries, by name (paper, section 2.1.5)."""

    include: Patterns = ()
    exclude: Patterns = ()
    fallback_z: float = 0.0


class PlacementSection(Section):
    """Where vehicles may stand (paper, section 2.1.5)."""

    margin: Annotated[float, Field(gt=0, le=1)] = 0.8
    max_slope_deg: Annotated[float, Field(ge=0, lt=90)] = 30.0
    rule: Literal["averaged", "least_squares", "support"] = "support"
    contact: Literal["footprint", "box"] = "footprint"
    footprint: Annotated[int, Field(ge=2, le=101)] = 5
    min_valid_share: Annotated[float, Field(gt=0, le=1)] = 0.8
    max_gap: AtLeastZero = 1.0
    max_penetration: AtLeastZero = 0.3
    fording_depth: AtLeastZero = 0.0
    obstacle_clearance: AtLeastZero = 0.5
    vehicle_clearance: AtLeastZero = 2.0
    vehicles_per_image: Counts = (1, 1)
    companion_distance: Lengths = (8.0, 40.0)
    distractors_per_image: CountsFromZero = (0, 3)
    distractor_distance: Lengths = (0.0, 40.0)
    articulate: bool = True
    max_tries: Annotated[int, Field(ge=1, le=1_000_000)] = 10_000


class CameraSection(Section):
    """Where cameras may be and what they must see (paper, section 2.1.6)."""

    fov_x_deg: FieldsOfView = (40.0, 60.0)
    size_measure: Literal["paper", "height", "width", "diagonal", "area"] = "paper"
    target_fraction: TargetFractions = (0.1, 0.3)
    distance_factor: Factors = (0.7, 4.0)
    distance_m: Lengths = (2.0, 5000.0)
    elevation_deg: Elevations = (3.0, 35.0)
    elevation_sampling: Literal["angle", "sphere"] = "angle"
    framing: Annotated[float, Field(ge=0, le=1)] = 0.8
    ground_clearance: AtLeastZero = 0.5
    obstacle_clearance: AtLeastZero = 1.0
    visible_fraction: Fractions = (0.3, 1.0)
    visibility_rays: Annotated[int, Field(ge=1, le=1_000_000)] = 256
    truncated_fraction: Fractions = (0.0, 0.0)
    min_box_px: AtLeastZero = 8.0
    max_tries: Annotated[int, Field(ge=1, le=10_000)] = 50


class AnnotateSection(Section):
    """What a label must show at least, and what becomes of the others; keys that are not given are as for targets."""

    min_box_px: AtLeastZero | None = None
    min_visible_fraction: Annotated[float, Field(ge=0, le=1)] | None = None
    max_truncated_fraction: Annotated[float, Field(ge=0, le=1)] | None = None
    below: Literal["ignored", "left_out"] = "ignored"


class BudgetSection(Section):
    """How many images: per class (paper, section 2.1.8), or by positions per vehicle (equation 1)."""

    images_per_class: PerClass = None
    positions_per_vehicle: Annotated[int, Field(ge=0, le=MOST_IMAGES)] | None = None
    images_per_position: Annotated[int, Field(ge=1, le=1_000_000)] = 5
    background_share: Annotated[float, Field(ge=0, le=0.99)] = 0.0
    background_distractors: Annotated[float, Field(ge=0, le=1)] = 0.5

    @model_validator(mode="after")
    def _one_of_two(self) -> BudgetSection:
        if (self.images_per_class is None) == (self.positions_per_vehicle is None):
            raise ValueError("expected exactly one of images_per_class and positions_per_vehicle")
        return self


class HdriChoice(Section):
    """An HDRI by name or pattern, and how often it is drawn."""

    name: str
    weight: AtLeastZero = 1.0


def _choice(value: Any) -> Any:
    if not isinstance(value, (str, dict, HdriChoice)):
        raise ValueError("expected a name or { name = ..., weight = ... }")
    return {"name": value} if isinstance(value, str) else value


class LightSection(Section):
    """HDRI, its turn about the vertical, its strength, what is seen of it; and how the camera meters it."""

    hdris: Annotated[tuple[Annotated[HdriChoice, BeforeValidator(_choice)], ...], Field(strict=False)] = ()
    yaw_deg: Degrees = (0.0, 360.0)
    strength: Strengths = (0.7, 1.3)
    backdrop: Literal["hdri", "sky"] = "hdri"
    exposure: Exposure = "auto"
    exposure_error_ev: ExposureErrors = (-1.0, 1.0)
    white_balance_error_k: Kelvins = (0.0, 0.0)
    overcast: Patterns = ()


PROFILES: Mapping[str, Mapping[str, Any]] = {
    "paper": {"samples": 128, "denoise": True, "adaptive_threshold": 0.0, "bounces": 12},
    "fast": {"samples": 32, "denoise": True, "adaptive_threshold": 0.05, "bounces": 4},
}


class RenderSection(Section):
    """Cycles' settings (paper, section 2.1.4); a profile sets the keys that are not given."""

    profile: Literal["paper", "fast"] = "paper"
    width: Annotated[int, Field(ge=1, le=65536)] = 1920
    height: Annotated[int, Field(ge=1, le=65536)] = 1080
    samples: Annotated[int, Field(ge=1, le=1_000_000)] = 128
    denoise: bool = True
    adaptive_threshold: Annotated[float, Field(ge=0, le=1)] = 0.0
    bounces: Annotated[int, Field(ge=0, le=1024)] = 12

    @model_validator(mode="before")
    @classmethod
    def _profile_first(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        profile = data.get("profile", "paper")
        return {**PROFILES[profile], **data} if isinstance(profile, str) and profile in PROFILES else data


class Config(Section):
    """A whole config; see docs/config.md for every key."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    assets: AssetsSection
    ground: GroundSection = GroundSection()
    placement: PlacementSection = PlacementSection()
    camera: CameraSection = CameraSection()
    annotate: AnnotateSection = AnnotateSection()
    budget: BudgetSection
    light: LightSection = LightSection()
    weather: WeatherSection = WeatherSection()
    render: RenderSection = RenderSection()

    @model_validator(mode="after")
    def _targets_are_labelled(self) -> Config:
        """What every target may be is enough for a label."""
        said, camera = self.annotate, self.camera
        for key, value, limit, ok in (
            ("min_box_px", said.min_box_px, f"camera.min_box_px = {camera.min_box_px:g} at most", camera.min_box_px),
            (
                "min_visible_fraction",
                said.min_visible_fraction,
                f"the least camera.visible_fraction, {camera.visible_fraction[0]:g}, at most",
                camera.visible_fraction[0],
            ),
        ):
            if value is not None and value > ok:
                raise ValueError(f"annotate.{key} = {value:g}: expected {limit}, since every target has a label")
        cut = said.max_truncated_fraction
        if cut is not None and cut < camera.truncated_fraction[1]:
            raise ValueError(
                f"annotate.max_truncated_fraction = {cut:g}: expected the largest camera.truncated_fraction, "
                f"{camera.truncated_fraction[1]:g}, at least, since every target has a label"
            )
        return self

    def paint_of(self, vehicle: str) -> tuple[PaintEntry, ...]:
        """How a vehicle or distractor is painted; not at all if there is none of this name."""
        entries = (*self.assets.vehicles, *self.assets.distractors)
        return next((entry.paint for entry in entries if entry.name == vehicle), ())

    _path: Path | None = PrivateAttr(default=None)

    @property
    def path(self) -> Path | None:
        """The file this was read from, if any."""
        return self._path

    @property
    def folder(self) -> Path:
        """What relative paths in the config are relative to."""
        return self._path.parent if self._path is not None else Path()

    def read_from(self, path: Path | None) -> Config:
        """The same config, knowing the file it was read from."""
        known = self.model_copy()
        known._path = path
        return known
