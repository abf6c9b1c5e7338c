"""The config's `[render]`: image size and Cycles' settings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from pydantic import Field, model_validator

from hulldown.planning.config.section import Section, Share, with_preset

LARGEST = 65536  # pixels of a side

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
