"""Candidates for places: positions and headings, uniform over a scenery."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.base.uniform import UniformNumbers


def sample_candidates(
    bounds: ArrayLike, n: int, *, rng: UniformNumbers, margin: float = 0.8
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Sample places uniformly in the share `margin` of the bounds, headings from +x; row i doesn't depend on `n`."""
    low, high = checked_array(np.asarray(bounds)[..., :2], "bounds", (2, 2))
    if (low > high).any():
        raise ValueError(f"bounds: expected the lowest corner first, got {low.tolist()} and {high.tolist()}")
    if n < 0:
        raise ValueError(f"n: expected a count of 0 or more, got {n}")
    if not 0.0 < margin <= 1.0:
        raise ValueError(f"margin: expected a share in (0, 1], got {margin}")
    uniform = rng.random((n, 3))
    xy = (low + high) / 2 + (uniform[:, :2] - 0.5) * (margin * (high - low))
    return xy, (uniform[:, 2] - 0.5) * (2 * np.pi)
