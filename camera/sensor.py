"""Parameters of a camera's lens, sensor, and processing. Runs in Blender too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Sensor:
    """Lens, sensor, and processing of an image. The defaults change nothing."""

    blur_px: float = 0.0  # standard deviation of the lens's point spread function
    aberration_px: float = 0.0  # how far red lies outward, and blue inward, of green in the corners
    vignetting_ev: float = 0.0  # loss of light in the corners, in stops
    full_well_e: float = 0.0  # electrons at which a pixel clips at base gain; 0 for a sensor without noise
    read_noise_e: float = 0.0  # standard deviation of the readout, in electrons
    gain: float = 1.0  # factor over base gain: a level needs that many times fewer electrons
    sharpening: float = 0.0  # share of the detail that is added
    jpeg_quality: int = 0  # 1 to 100; 0 for PNG

    def __post_init__(self) -> None:
        for key, (low, high) in LIMITS.items():
            if not low <= getattr(self, key) <= high:
                raise ValueError(f"sensor.{key}: expected {low:g} to {high:g}, got {getattr(self, key)!r}")

    def falloff(self, x: np.ndarray, y: np.ndarray, corner: float) -> np.ndarray:
        """Return the share of light that arrives at (x, y) from the axis: the fourth power of a cosine.

        References
        ----------
        P. Slater, Remote Sensing, 1980.
        """
        return (1.0 + (2.0 ** (self.vignetting_ev / 2.0) - 1.0) / corner**2 * (x**2 + y**2)) ** -2

    @property
    def suffix(self) -> str:
        """Extension of the pictures' file names."""
        return ".jpg" if self.jpeg_quality else ".png"


LIMITS = {
    "blur_px": (0.0, 8.0),
    "aberration_px": (-32.0, 32.0),
    "vignetting_ev": (0.0, 8.0),
    "full_well_e": (0.0, 1e7),
    "read_noise_e": (0.0, 1e4),
    "gain": (1.0, 1e4),
    "sharpening": (0.0, 8.0),
    "jpeg_quality": (0.0, 100.0),
}
