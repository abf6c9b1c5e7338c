"""The config's `[camera]`: lens, distance, direction, framing, and what must be visible."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hulldown.planning.config.section import AtLeastZero, Lengths, Pair, Section, Share, is_absent, ranged

LIKE_SHARE, LIKE_SPREAD = 0.7, 0.2

Shares = Annotated[Pair, ranged(0.0, 1.0)]


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
    like: str | None = Field(default=None, min_length=1, examples=["photographs/train"], exclude_if=is_absent)
    """photographs whose boxes targets follow: a COCO file, or a folder of COCO, YOLO, or VOC"""
    like_share: Share = Field(default=LIKE_SHARE, exclude_if=LIKE_SHARE.__eq__)
    """share of images that follow photographs"""
    like_spread: float = Field(default=LIKE_SPREAD, ge=0, le=0.9, exclude_if=LIKE_SPREAD.__eq__)
    """largest deviation from the photograph's box, relative to its size"""
