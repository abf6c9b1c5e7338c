"""What weather does to surfaces, as formulas: how wet ground darkens, on which slopes snow lies, how high dust climbs.

Cycles' nodes compute the same (`render.blender.covers`); tests compare. Needs numpy only.
"""

from __future__ import annotations

import numpy as np

# Lagarde: a surface soaks up water if it is rougher than 0.5 (perceptual roughness), fully from 0.9 on.
POROUS_FROM, POROUS_AT = 0.5, 0.9
WET_DIFFUSE = 0.6  # of the dry albedo where fully porous; his 0.2 turns soil twice as dark as measured
WET_ROUGHNESS = 0.65  # of the dry roughness there
SNOW_ALBEDO = (0.80, 0.83, 0.86)
SNOW_LIES_TO, SNOW_SLIDES_FROM = 30.0, 60.0  # degrees of slope with all of the cover, and from which none is left
DUST_ALBEDO = (0.36, 0.28, 0.19)
DUST_FULL_TO, DUST_TO = 0.2, 1.2  # metres above a vehicle's underside
DUST_ON_TOPS = 0.35  # of what lies on the lower parts; on scenery too


def porosity(roughness: np.ndarray, metallic: np.ndarray | float = 0.0) -> np.ndarray:
    """How much water a surface soaks up, 0 to 1, by perceptual roughness (0 to 1) and metalness.

    References
    ----------
    Lagarde, "Water drop 3b: physically based wet surfaces", 2013.
    """
    return np.clip((np.asarray(roughness) - POROUS_FROM) / (POROUS_AT - POROUS_FROM), 0, 1) * (1 - metallic)


def wet_albedo_factor(roughness: np.ndarray, wetness: float) -> np.ndarray:
    """What wetness, 0 to 1, leaves of the diffuse albedo of a surface that is no metal."""
    return 1 - (1 - WET_DIFFUSE) * wetness * porosity(roughness)


def snow_share(slope_deg: np.ndarray, cover: float) -> np.ndarray:
    """Share of an open surface that is under snow, where `cover` of level ground is."""
    low, high = np.cos(np.radians([SNOW_SLIDES_FROM, SNOW_LIES_TO]))
    x = np.clip((np.cos(np.radians(slope_deg)) - low) / (high - low), 0, 1)
    return cover * x * x * (3 - 2 * x)
