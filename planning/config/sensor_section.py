"""The config's `[sensor]`: lens, sensor, and image processing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import model_validator

from hulldown.camera.sensor import LIMITS
from hulldown.planning.config.section import Pair, Section, ranged, with_preset

PRESETS: Mapping[str, Mapping[str, object]] = {
    "none": {},
    "camera": {
        "blur_px": (0.4, 0.8),
        "aberration_px": (-0.5, 0.5),
        "vignetting_ev": (0.2, 1.0),
        "full_well_e": 50_000,
        "read_noise_e": 3,
        "gain": (1, 4),
        "sharpening": (0.0, 0.6),
        "jpeg_quality": (85, 97),
    },
    "phone": {
        "blur_px": (0.5, 1.0),
        "aberration_px": (-0.3, 0.3),
        "vignetting_ev": (0.1, 0.5),
        "full_well_e": 20_000,
        "read_noise_e": 2,
        "gain": (1, 4),
        "sharpening": (0.4, 1.2),
        "jpeg_quality": (75, 92),
    },
}


class SensorSection(Section):
    """Effects of lens, sensor, and image processing; a preset gives defaults."""

    preset: Literal["none", "camera", "phone"] = "none"
    """a system camera or a phone; sets all keys below"""
    blur_px: Annotated[Pair, ranged(*LIMITS["blur_px"])] = (0.0, 0.0)
    """standard deviation of the lens's point spread, pixels"""
    aberration_px: Annotated[Pair, ranged(*LIMITS["aberration_px"])] = (0.0, 0.0)
    """red's offset outward and blue's inward in the corners, pixels"""
    vignetting_ev: Annotated[Pair, ranged(*LIMITS["vignetting_ev"])] = (0.0, 0.0)
    """light lost in the corners, stops"""
    full_well_e: Annotated[Pair, ranged(*LIMITS["full_well_e"])] = (0.0, 0.0)
    """electrons at which a pixel clips, 6.5 stops above middle gray; 0: no noise"""
    read_noise_e: Annotated[Pair, ranged(*LIMITS["read_noise_e"])] = (0.0, 0.0)
    """readout noise, electrons"""
    gain: Annotated[Pair, ranged(*LIMITS["gain"])] = (1.0, 1.0)
    """ISO over base ISO, which divides the electrons of a pixel"""
    sharpening: Annotated[Pair, ranged(*LIMITS["sharpening"])] = (0.0, 0.0)
    """share of detail added again, after the view transform"""
    jpeg_quality: Annotated[tuple[int, int], ranged(*LIMITS["jpeg_quality"], int)] = (0, 0)
    """quality of .jpg files; 0: .png files"""

    @model_validator(mode="before")
    @classmethod
    def _preset_first(cls, data: object) -> object:
        return with_preset(data, "preset", PRESETS)

    @model_validator(mode="after")
    def _with_or_without(self) -> SensorSection:
        for key in ("full_well_e", "jpeg_quality"):
            low, high = getattr(self, key)
            if low == 0 < high:
                raise ValueError(f"{key} = [0, {high:g}]: expected 0, or a range of more than 0")
        return self
