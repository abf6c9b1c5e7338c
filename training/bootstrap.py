"""How sure a figure is: intervals by drawing the positions of a test set again, with replacement.

Shots of one position show one vehicle on one piece of ground. They are drawn together, since they are found or missed
together; a photograph is a position of its own.

References
----------
Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 13.3 (percentile intervals).
Wilson, Probable inference, the law of succession, and statistical inference, JASA 1927.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from training.metrics import figures, ratio

RESAMPLES = 2000
LEVEL = 0.95
Z = 1.959963984540054  # of a two-sided 95 % interval of the normal distribution
DRAWN_AT_ONCE = 1 << 22


def resamples(groups: int, *, times: int = RESAMPLES, seed: int = 0) -> Iterator[Float[np.ndarray, "r groups"]]:
    """How often each group was drawn, in `times` drawings of as many as there are; some drawings at a time."""
    random = np.random.default_rng(seed)
    rows = max(1, DRAWN_AT_ONCE // max(groups, 1))
    for start in range(0, times, rows):
        now = min(rows, times - start)
        drawn = random.integers(0, groups, (now, groups)) + np.arange(now)[:, None] * groups
        yield np.bincount(drawn.ravel(), minlength=now * groups).reshape(now, groups).astype(np.float64)


def resampled_sums(
    sums: Float[np.ndarray, "groups *columns"], *, times: int = RESAMPLES, seed: int = 0
) -> Float[np.ndarray, "r *columns"]:
    """Sums over the groups of each drawing; of one seed and number of groups the drawings are the same."""
    if not len(sums):
        return np.zeros((times, *sums.shape[1:]))
    flat = sums.reshape(len(sums), -1)
    return np.concatenate([weights @ flat for weights in resamples(len(sums), times=times, seed=seed)]).reshape(
        times, *sums.shape[1:]
    )


def interval(values: Float[np.ndarray, "r *shape"]) -> Float[np.ndarray, "2 *shape"]:
    """Lower and upper end of the middle 95 % of what the drawings gave; nan where most gave nothing."""
    if np.isnan(values).any():
        enough = np.isnan(values).mean(axis=0) <= 0.5
        filled = np.where(enough, values, 0.0)
        ends = np.nanquantile(filled, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2], axis=0)
        return np.where(enough, ends, np.nan)
    return np.quantile(values, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2], axis=0)


def figure_intervals(resampled: Float[np.ndarray, "r 6"]) -> dict[str, Float[np.ndarray, "2"]]:
    """Intervals of all figures from resampled sums."""
    return {key: interval(values) for key, values in figures(resampled).items()}


def difference_intervals(
    first: Float[np.ndarray, "r 6"], second: Float[np.ndarray, "r 6"]
) -> dict[str, Float[np.ndarray, "2"]]:
    """Intervals of second minus first, where both were resampled with the same drawings."""
    before, after = figures(first), figures(second)
    return {key: interval(after[key] - before[key]) for key in before}


def wilson(part: Float[np.ndarray, " n"], whole: Float[np.ndarray, " n"]) -> Float[np.ndarray, "2 n"]:
    """Lower and upper end of the 95 % interval of a share; nan where the whole is 0.

    Examples
    --------
    >>> wilson(np.array([0.0, 10.0]), np.array([10.0, 10.0])).round(4).tolist()
    [[0.0, 0.7225], [0.2775, 1.0]]
    """
    share = ratio(part, whole)
    scale = ratio(np.full_like(share, Z * Z), whole)
    middle = (share + scale / 2.0) / (1.0 + scale)
    reach = np.sqrt(share * (1.0 - share) * scale + scale * scale / 4.0) / (1.0 + scale)
    return np.clip(np.stack([middle - reach, middle + reach]), 0.0, 1.0)
