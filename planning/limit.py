"""What a limit is: a name, the config's keys and bounds, how it is recomputed, and what breaking it is called."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Bool, Float, UInt8

from placement.rejection import Rejection
from planning.schema import Config

if TYPE_CHECKING:
    from planning.recomputed import Recomputed

Bounds = tuple[float | int, float | int]
INFINITY = math.inf


def _holds(config: Config) -> Bounds:
    return 1.0, 1.0


@dataclass(frozen=True, eq=False, slots=True)
class Limit:
    """One limit.

    Parameters
    ----------
    name
        What findings and docs call it.
    keys
        Keys of the config that set it, as "section.key".
    how
        What it is recomputed from, for the docs.
    measure
        The n values that it bounds; or whether it holds, if it is no matter of degree.
    bounds
        Least and largest value that the config allows; None where this config has no such limit.
    of
        What it is about: each image, each target, each companion, each distractor, or each vehicle, all of them.
    slack, relative
        What rounding may add, absolute and as a share of the bounds.
    below, above
        The rejection of a try whose value is too small or too large. NONE where tries are drawn within the bounds.
    """

    name: str
    keys: tuple[str, ...]
    how: str
    measure: Callable[[Recomputed], np.ndarray]
    bounds: Callable[[Config], Bounds | None] = _holds
    of: Literal["image", "target", "companion", "distractor", "vehicle"] = "image"
    slack: float = 0.0
    relative: float = 0.0
    below: Rejection = Rejection.NONE
    above: Rejection = Rejection.NONE

    def rejections(self, values: Float[np.ndarray, " n"], config: Config) -> UInt8[np.ndarray, " n"]:
        """A code of `Rejection` for each value of the search; nan is too small."""
        low, high = self.bounds(config) or (-INFINITY, INFINITY)
        return np.where(values >= low, np.where(values <= high, Rejection.NONE, self.above), self.below).astype(
            np.uint8
        )

    def highest(self, config: Config) -> float:
        """The largest value allowed."""
        return float((self.bounds(config) or (-INFINITY, INFINITY))[1])

    def lowest(self, config: Config) -> float:
        """The least value allowed."""
        return float((self.bounds(config) or (-INFINITY, INFINITY))[0])

    def kept(self, values: np.ndarray, config: Config) -> Bool[np.ndarray, " n"]:
        """Which recomputed values are within the bounds, but for rounding; nan is not."""
        bounds = self.bounds(config)
        if bounds is None:
            return np.ones(len(values), dtype=bool)
        low, high = bounds
        # No share of an infinite bound, which would be nan.
        below, above = (self.slack + (self.relative * abs(bound) if self.relative else 0.0) for bound in bounds)
        return np.asarray((values >= low - below) & (values <= high + above))
