"""The sequence of training pictures, fixed before training.

"25,000 randomly sampled images (with replacement)" (paper, section 2.2). Row k is a function of the seed and k alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from hulldown.base.errors import ConfigError


@dataclass(frozen=True, eq=False, slots=True)
class Draws:
    """n draws from the pictures of several sources."""

    source: Int[np.ndarray, " n"]
    image: Int[np.ndarray, " n"]
    seed: Int[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.source)


def make_draws(sizes: Sequence[int], budget: int, *, seed: int, shares: Sequence[float] = ()) -> Draws:
    """Draw pictures with replacement, by `shares` of the sources, see `source_shares`; else all are equally likely."""
    if not sizes or min(sizes) < 1:
        raise ValueError(f"sizes: expected at least one picture in each of at least one source, got {list(sizes)}")
    if shares and len(shares) != len(sizes):
        raise ValueError(f"shares: expected one for each of {len(sizes)} sources, got {list(shares)}")
    low = np.concatenate(([0.0], np.cumsum(shares or np.divide(sizes, sum(sizes)))))
    # Raw output of a counter-based generator: the same on every machine and with every version of NumPy.
    raw = np.random.Philox(key=seed).random_raw(3 * budget).reshape(budget, 3)
    unit = (raw[:, :2] >> np.uint64(11)) * 2.0**-53
    source = np.minimum(np.searchsorted(low, unit[:, 0], side="right") - 1, len(sizes) - 1)
    image = (unit[:, 1] * np.asarray(sizes)[source]).astype(np.int64)
    return Draws(source.astype(np.int64), image, (raw[:, 2] >> np.uint64(32)).astype(np.int64))


def source_shares(sizes: Mapping[str, int], shares: Mapping[str, float]) -> list[float]:
    """Return each source's share of the draws: that in `shares`, or a part of the rest by its pictures in `sizes`."""
    for name, share in shares.items():
        if name not in sizes:
            raise ConfigError(f"shares.{name}: no source has this name; there are {', '.join(sizes)}")
        if not 0.0 <= share <= 1.0:
            raise ConfigError(f"shares.{name} = {share:g}: expected a number from 0 to 1")
    total = math.fsum(shares.values())
    if total > 1.0 + 1e-9 or (len(shares) == len(sizes) and total < 1.0 - 1e-9):
        raise ConfigError(f"shares: they add up to {total:g}, expected 1", remedy="leave one of them out")
    open_pictures = sum(size for name, size in sizes.items() if name not in shares)
    return [shares[name] if name in shares else (1.0 - total) * n / open_pictures for name, n in sizes.items()]
