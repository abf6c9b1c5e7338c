"""The bounds by which the search rejects its tries, and the rejection that each is counted as."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from placement.rejection import Rejection
from planning.schema import Config

SIZED = 1e-9  # of the wanted size: the solve and the box's own projection round differently
COMPANION_TRIES = 50  # places for one companion or distractor before the target is moved elsewhere


@dataclass(frozen=True, eq=False, slots=True)
class Limit:
    """A least and a largest value, by a config, and the rejections of tries that are outside of them.

    Parameters
    ----------
    bounds
        The config's bounds, inclusive.
    below, above
        The rejection of a try whose value is too small or too large.
    """

    bounds: Callable[[Config], tuple[float, float]]
    below: Rejection = Rejection.NONE
    above: Rejection = Rejection.NONE

    def rejections(self, values: Float[np.ndarray, " n"], config: Config) -> UInt8[np.ndarray, " n"]:
        """A code of `Rejection` for each value; nan is too small."""
        low, high = self.bounds(config)
        return np.where(values >= low, np.where(values <= high, Rejection.NONE, self.above), self.below).astype(
            np.uint8
        )

    def lowest(self, config: Config) -> float:
        """The least value allowed."""
        return self.bounds(config)[0]

    def highest(self, config: Config) -> float:
        """The largest value allowed."""
        return self.bounds(config)[1]


# Where a vehicle stands.
VALID_SHARE = Limit(lambda config: (config.placement.min_valid_share, 1.0), below=Rejection.OVERHANG)
SLOPE = Limit(lambda config: (0.0, config.placement.max_slope_deg), above=Rejection.MEAN_TOO_STEEP)
GAP = Limit(lambda config: (0.0, config.placement.max_gap), above=Rejection.GAP)
PENETRATION = Limit(lambda config: (0.0, config.placement.max_penetration), above=Rejection.PENETRATION)
FORDING = Limit(lambda config: (0.0, config.placement.fording_depth), above=Rejection.WATER)
PLACE_TRIES = Limit(lambda config: (1.0, config.placement.max_tries))
# What a camera sees.
DISTANCE = Limit(lambda config: config.camera.distance_m, below=Rejection.DISTANCE, above=Rejection.DISTANCE)
AIR_CONTRAST = Limit(lambda config: (config.weather.min_contrast, 1.0), below=Rejection.FAINT)
TRUNCATED = Limit(
    lambda config: config.camera.truncated_fraction, below=Rejection.TRUNCATION, above=Rejection.TRUNCATION
)
BOX_PX = Limit(lambda config: (config.camera.min_box_px, np.inf), below=Rejection.SMALL)
VISIBLE = Limit(lambda config: config.camera.visible_fraction, below=Rejection.HIDDEN, above=Rejection.EXPOSED)
PIXELS = Limit(lambda config: (1.0, np.inf), below=Rejection.HIDDEN)
