"""The config's sections but `[assets]`: vehicles and cameras, light and weather, labels, numbers, and pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from hulldown.base.arrays import are_finite_numbers
from hulldown.camera.response import MAX_BALANCE_ERROR_K, MAX_EV, MIN_BALANCE_ERROR_K
from hulldown.plan.config.section import (
    AtLeastZero,
    Lengths,
    Pair,
    Patterns,
    Section,
    Share,
    is_omitted_default,
    range_validator,
)
from hulldown.weather.extinction import MIN_LABEL_CONTRAST
from hulldown.weather.kinds import WEATHER_KINDS

LIKE_SHARE, LIKE_SPREAD = 0.7, 0.2
MAX_CLASS_IMAGES = 1_000_000_000
MAX_IMAGE_SIDE_PX = 65536
RENDER_PROFILES: Mapping[str, Mapping[str, object]] = {
    "paper": {"samples": 128, "denoise": True, "adaptive_threshold": 0.0, "bounces": 12},
    "fast": {"samples": 32, "denoise": True, "adaptive_threshold": 0.05, "bounces": 4},
    "train": {"samples": 8, "denoise": True, "adaptive_threshold": 0.05, "bounces": 4},
}

Shares = Annotated[Pair, range_validator(0.0, 1.0)]
Visibilities = Annotated[Pair, range_validator(1.0, 1e6)]
SkeletonLines = Annotated[tuple[Annotated[tuple[str, str], Field(strict=False)], ...], Field(strict=False)]


class GroundSection(Section):
    """What replaces missing ground (paper, section 2.1.5)."""

    fallback_z: float = 0.0
    """height of the plane that replaces missing ground, meters"""


class PlacementSection(Section):
    """Where vehicles are placed (paper, section 2.1.5)."""

    margin: float = Field(default=0.8, gt=0, le=1)
    """middle share of the scenery's extent in which targets are placed"""
    max_slope_deg: float = Field(default=30.0, ge=0, lt=90)
    """steepest ground under the vehicle's origin and the whole vehicle"""
    rule: Literal["averaged", "support"] = "support"
    """how the resting plane is found ("averaged": the paper)"""
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
    vehicles_per_image: Annotated[tuple[int, int], range_validator(1.0, 64.0, int)] = (1, 1)
    """the target and companions; budgets count targets only"""
    companion_distance: Lengths = (8.0, 40.0)
    """meters from the target to a companion"""
    distractors_per_image: Annotated[tuple[int, int], range_validator(0.0, 64.0, int)] = (0, 3)
    """distractors in an image, if the scenery has any"""
    distractor_distance: Lengths = (0.0, 40.0)
    """meters from the target to a distractor, uniform by area"""
    articulate: bool = True
    """turn turrets and raise guns"""
    max_tries: int = Field(default=10_000, ge=1, le=1_000_000)
    """places tried for a position"""


class CameraMatrix(Section):
    """OpenCV's camera matrix K in pixels."""

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

    fov_x_deg: Annotated[Pair, range_validator(0.1, 179.0)] = (40.0, 60.0)
    """horizontal field of view, degrees"""
    intrinsics: CameraMatrix | None = Field(
        default=None, examples=[{"fx": 1420.0, "fy": 1418.5, "cx": 964.2, "cy": 545.7}], exclude_if=is_omitted_default
    )
    """a calibrated camera's focal lengths and principal point, in pixels from the first pixel's corner: OpenCV's K,
    with 0.5 added to cx and cy; replaces fov_x_deg"""
    distortion: Distortion | None = Field(
        default=None,
        examples=[{"k1": -0.21, "k2": 0.07, "p1": 0.0003, "p2": -0.0001, "k3": 0.0}],
        exclude_if=is_omitted_default,
    )
    """its lens distortion (OpenCV's Brown-Conrady); needs intrinsics"""
    roll_deg: Annotated[Pair, range_validator(-180.0, 180.0)] = Field(default=(0.0, 0.0), exclude_if=is_omitted_default)
    """turn about the optical axis, degrees; positive lowers the right side"""
    size_measure: Literal["paper", "height", "width", "diagonal", "area"] = "paper"
    """what target_fraction measures: "paper", the vehicle's smallest dimension; else the projected box"""
    target_fraction: Annotated[Pair, range_validator(1e-4, 10.0)] = (0.1, 0.3)
    """share of the image that the target fills"""
    distance_factor: Annotated[Pair, range_validator(1e-3, 1e3)] = (0.7, 4.0)
    """factor on equation 6's distance; with size_measure = "paper" only"""
    distance_m: Lengths = (2.0, 5000.0)
    """bounds on meters from target to camera"""
    elevation_deg: Annotated[Pair, range_validator(-90.0, 90.0)] = (3.0, 35.0)
    """camera's angle above the target's horizon, degrees"""
    elevation_sampling: Literal["angle", "sphere"] = "angle"
    """"angle": uniform in degrees; "sphere": uniform on the shell's area"""
    framing: Share = 0.8
    """0 centers the target; 1 lets it be anywhere in the frame"""
    ground_clearance: AtLeastZero = 0.5
    """meters above ground and water, at least"""
    obstacle_clearance: AtLeastZero = 1.0
    """meters to obstacles and vehicles, at least"""
    visible_fraction: Shares = (0.3, 1.0)
    """unhidden share of the target's outline"""
    visibility_rays: int = Field(default=256, ge=1, le=1_000_000)
    """rays that measure visible_fraction"""
    truncated_fraction: Shares = (0.0, 0.0)
    """share of the target's box that the frame cuts off"""
    min_box_px: AtLeastZero = 8.0
    """least width and height of the target's box, pixels"""
    max_tries: int = Field(default=50, ge=1, le=10_000)
    """cameras tried for an image before the vehicle is moved"""
    like: str | None = Field(default=None, min_length=1, examples=["photographs/train"], exclude_if=is_omitted_default)
    """photographs whose boxes targets follow: a COCO file, or a folder of COCO, YOLO, or VOC"""
    like_share: Share = Field(default=LIKE_SHARE, exclude_if=LIKE_SHARE.__eq__)
    """share of images that follow photographs"""
    like_spread: float = Field(default=LIKE_SPREAD, ge=0, le=0.9, exclude_if=LIKE_SPREAD.__eq__)
    """largest deviation from the photograph's box, relative to its size"""


class AnnotateSection(Section):
    """The least that a labeled vehicle must show; by default, the camera's limits for targets."""

    min_box_px: AtLeastZero | None = Field(default=None, examples=[8.0])
    """least width and height of its box, pixels; default: camera.min_box_px"""
    min_visible_fraction: Share | None = Field(default=None, examples=[0.3])
    """least unhidden share; default: the least camera.visible_fraction"""
    max_truncated_fraction: Share | None = Field(default=None, examples=[0.8])
    """largest share of its box that the frame cuts off; default: 0.8, or the largest camera.truncated_fraction if
    that's more"""
    below: Literal["ignored", "left_out"] = "ignored"
    """vehicles that show less get a label with iscrowd = 1 ("ignored") or none ("left_out")"""
    keypoints: Patterns | None = Field(default=None, examples=[["*"]], exclude_if=is_omitted_default)
    """patterns of the keypoints to label, such as wheel_*; default: none"""
    skeleton: SkeletonLines | None = Field(default=None, examples=[[["muzzle", "turret"]]], exclude_if=is_omitted_default)
    """pairs of keypoints to join; default: none"""


def _require_class_counts(value: object) -> object:
    """Check a number of images for every class, or a table of numbers by class."""
    counts = list(value.values()) if isinstance(value, dict) else [value]
    if value is not None and any(type(n) is not int or not 0 <= n <= MAX_CLASS_IMAGES for n in counts):
        raise ValueError(f"expected a whole number from 0 to {MAX_CLASS_IMAGES}, or a table of them by class")
    return value


PerClass = Annotated[int | dict[str, int] | None, BeforeValidator(_require_class_counts)]


class BudgetSection(Section):
    """The number of images: per class (paper, section 2.1.8), or by positions per vehicle (equation 1)."""

    images_per_class: PerClass = Field(default=None, examples=[140])
    """a number, or a table such as { tank = 200, truck = 100 }; a class's models take turns"""
    positions_per_vehicle: int | None = Field(default=None, ge=0, le=MAX_CLASS_IMAGES, examples=[28])
    """instead: vehicles x positions x images_per_position images (equation 1)"""
    images_per_position: int = Field(default=5, ge=1, le=1_000_000)
    """images of each position"""
    background_share: float = Field(default=0.0, ge=0, le=0.99)
    """share of images without a target, added to those above"""
    background_distractors: Share = 0.5
    """share of background positions where a distractor replaces the target"""

    @model_validator(mode="after")
    def _require_one_budget(self) -> BudgetSection:
        if (self.images_per_class is None) == (self.positions_per_vehicle is None):
            raise ValueError("expected exactly one of images_per_class and positions_per_vehicle")
        return self


def _parse_exposure(value: Any) -> str | float:
    if value == "auto":
        return "auto"
    if are_finite_numbers([value]) and abs(value) <= MAX_EV:
        return float(value)
    raise ValueError(f"expected 'auto' or EV from {-MAX_EV:g} to {MAX_EV:g}")


Exposure = Annotated[Literal["auto"] | float, BeforeValidator(_parse_exposure)]


class HdriChoice(Section):
    """A pattern of HDRI names, and how often these HDRIs are drawn."""

    name: str
    weight: AtLeastZero = 1.0


def _parse_hdri_choice(value: object) -> object:
    if not isinstance(value, (str, dict, HdriChoice)):
        raise ValueError("expected a name or { name = ..., weight = ... }")
    return {"name": value} if isinstance(value, str) else value


class LightSection(Section):
    """HDRIs, their rotation, strength, and visible part, and the exposure of the camera."""

    hdris: Annotated[tuple[Annotated[HdriChoice, BeforeValidator(_parse_hdri_choice)], ...], Field(strict=False)] = ()
    """patterns of HDRIs, or { name = "noon*", weight = 2.0 }; empty: all, equally often"""
    yaw_deg: Annotated[Pair, range_validator(-360.0, 360.0)] = (0.0, 360.0)
    """turn of the HDRI, degrees"""
    strength: Annotated[Pair, range_validator(0.0, 1e9)] = (0.7, 1.3)
    """factor on the HDRI's brightness; exposure = "auto" compensates for it"""
    backdrop: Literal["auto", "hdri", "sky"] = "auto"
    """what the camera sees of the HDRI: "hdri", all; "sky", above its horizon; "auto", "sky" if it shows land"""
    exposure: Exposure = "auto"
    """"auto": a gray card on open land comes out mid-gray; or EV for all images"""
    exposure_error_ev: Annotated[Pair, range_validator(-10.0, 10.0)] = (-1.0, 1.0)
    """error of the exposure, EV"""
    white_balance_error_k: Annotated[Pair, range_validator(MIN_BALANCE_ERROR_K, MAX_BALANCE_ERROR_K)] = (0.0, 0.0)
    """white balance minus 6500 K; more is warmer"""
    overcast: Patterns = ()
    """patterns of HDRIs for rain and snow; empty: as for other weather"""


class WeatherSection(Section):
    """Shares of images with each kind of weather of `WEATHER_KINDS`, and its ranges; other images are clear."""

    fog: Share = 0.0
    """share of images with fog"""
    rain: Share = 0.0
    """share with rain"""
    snow: Share = 0.0
    """share with falling snow"""
    dust: Share = 0.0
    """share with blown dust"""
    visibility_m: Visibilities = (300.0, 3000.0)
    """visibility in fog, meters; 3000 is haze"""
    rain_mm_h: Annotated[Pair, range_validator(0.1, 300.0)] = (2.0, 50.0)
    """rate of rain, mm/h: 2 is light, 10 heavy, 50 a cloudburst"""
    snow_visibility_m: Visibilities = (300.0, 2000.0)
    """visibility in falling snow, meters"""
    dust_visibility_m: Visibilities = (200.0, 2000.0)
    """visibility in blown dust, meters"""
    snow_cover: Shares = (0.3, 1.0)
    """share of the ground under snow"""
    vehicle_snow_cover: Shares = (0.0, 0.8)
    """share of a vehicle's upper faces under snow"""
    dust_cover: Shares = (0.0, 0.5)
    """share of the ground under dust"""
    vehicle_dust_cover: Shares = (0.1, 0.8)
    """share of a vehicle's lower parts under dust"""
    wind_m_s: Annotated[Pair, range_validator(0.0, 60.0)] = (0.0, 8.0)
    """wind in rain, snow, and dust, from any direction, m/s"""
    exposure_s: float = Field(default=0.004, gt=0, le=10)
    """shutter time, seconds: the length of streaks"""
    min_contrast: Share = MIN_LABEL_CONTRAST
    """contrast that a target must keep after haze; 0 allows ghosts"""

    @model_validator(mode="after")
    def _refuse_shares_above_one(self) -> WeatherSection:
        total = math.fsum(getattr(self, name) for name in WEATHER_KINDS)
        if total > 1.0 + 1e-9:
            raise ValueError(f"{', '.join(WEATHER_KINDS)} are {total:g} together; expected shares of at most 1 in all")
        return self


class RenderSection(Section):
    """Cycles' settings (paper, section 2.1.4); a profile gives defaults for some of them."""

    profile: Literal["paper", "fast", "train"] = "paper"
    """sets the last four keys; "fast" is for a look, "train" for many images in little time"""
    width: int = Field(default=1920, ge=1, le=MAX_IMAGE_SIDE_PX)
    """pixels"""
    height: int = Field(default=1080, ge=1, le=MAX_IMAGE_SIDE_PX)
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
    def _fill_profile_defaults(cls, data: object) -> object:
        if isinstance(data, dict) and isinstance(name := data.get("profile"), str) and name in RENDER_PROFILES:
            return {**RENDER_PROFILES[name], **data}  # given values win
        return data
