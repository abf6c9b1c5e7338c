"""The config's `[annotate]`: which vehicles have labels, and their keypoints."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hulldown.planning.config.section import AtLeastZero, Patterns, Section, Share, is_absent

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
    """patterns of the keypoints to label, such as wheel_*; default: none"""
    skeleton: Lines | None = Field(default=None, examples=[[["muzzle", "turret"]]], exclude_if=is_absent)
    """pairs of keypoints to join; default: none"""
