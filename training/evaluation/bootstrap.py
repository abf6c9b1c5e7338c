"""Confidence intervals from resampled positions of a test set.

Shots of one position show one vehicle on the same ground, and are found or missed together, so they're resampled
together. Each photograph is its own position. Percentiles of few resampled positions cover far too little (five
labels, all found, would give 1.000 to 1.000), so an interval is Wilson's, with the number of trials that matches the
resampled spread, and with Student's quantile. docs/evaluation.md has the measured coverage.

Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapters 6 and 8.
Wilson, Probable inference, the law of succession, and statistical inference, JASA 1927.
Korn and Graubard, Confidence intervals for proportions with small expected number of positive counts estimated from
survey data, Survey Methodology 1998: the effective number of trials.
Bonett and Price, Adjusted Wald confidence interval for a difference of binomial proportions based on paired data,
Journal of Educational and Behavioral Statistics 2012.
Satterthwaite, An approximate distribution of estimates of variance components, Biometrics Bulletin 1946.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from hulldown.training.evaluation.metrics import MEAN_METRICS, ratio_or_nan

RESAMPLE_COUNT = 2000
MIN_ERROR = 1e-150  # the square of a smaller one underflows
CONFIDENCE_LEVEL = 0.95
MIN_POSITIONS = 5  # with fewer, coverage wasn't measured, so there is no interval
MAX_BATCH_DRAWS = 1 << 22


def draw_resamples(groups: int, *, times: int = RESAMPLE_COUNT) -> Iterator[Float[np.ndarray, "r groups"]]:
    """Yield batches of resamples, `times` in all: the count of each group in each resample."""
    random = np.random.default_rng(0)
    rows = max(1, MAX_BATCH_DRAWS // max(groups, 1))
    for start in range(0, times, rows):
        now = min(rows, times - start)
        chosen = random.integers(0, max(groups, 1), (now, groups)) + np.arange(now)[:, None] * groups
        yield np.bincount(chosen.ravel(), minlength=now * groups).reshape(now, groups).astype(np.float64)


def resample_sums(
    sums: Float[np.ndarray, "groups *columns"], *, times: int = RESAMPLE_COUNT
) -> Float[np.ndarray, "r *columns"]:
    """Return sums over the groups of each resample; resamples depend on the number of groups alone."""
    return np.concatenate([np.tensordot(weights, sums, 1) for weights in draw_resamples(len(sums), times=times)])


def resampled_standard_error(resampled: Float[np.ndarray, "r *shape"], groups: ArrayLike) -> Float[np.ndarray, "*shape"]:
    """Return the standard error by resampling; nan with fewer than `MIN_POSITIONS` groups or few defined resamples."""
    groups = np.asarray(groups, dtype=np.float64)
    known = ~np.isnan(resampled)
    count = known.sum(axis=0)
    mean = np.where(known, resampled, 0.0).sum(axis=0) / np.maximum(count, 1)
    variance = (np.where(known, resampled - mean, 0.0) ** 2).sum(axis=0) / np.maximum(count, 1)
    enough = (groups >= MIN_POSITIONS) & (2 * count > len(resampled))
    return np.where(enough, np.sqrt(variance * groups / np.maximum(groups - 1.0, 1.0)), np.nan)


def ratio_standard_error(
    part: Float[np.ndarray, "groups *shape"], whole: Float[np.ndarray, "groups *shape"]
) -> Float[np.ndarray, "*shape"]:
    """Return the standard error of a ratio of sums by the delta method, without resampling."""
    groups = (whole > 0).sum(axis=0)
    total = whole.sum(axis=0)
    off = part - ratio_or_nan(part.sum(axis=0), total) * whole
    variance = ratio_or_nan((off**2).sum(axis=0), total**2)
    return np.where(groups >= MIN_POSITIONS, np.sqrt(variance * groups / np.maximum(groups - 1.0, 1.0)), np.nan)


def share_interval(
    value: ArrayLike, error: ArrayLike, *, freedom: ArrayLike, trials: ArrayLike = np.inf
) -> Float[np.ndarray, "2 *shape"]:
    """Return Wilson's 95 % interval of a share with this `error` of `freedom` degrees; nan if `error` is."""
    value, error, freedom = (np.asarray(n, dtype=np.float64) for n in (value, error, freedom))
    spread = value * (1.0 - value)
    variance = np.maximum(error, MIN_ERROR) ** 2
    worth = np.where((error > 0) & (spread > 0), ratio_or_nan(spread, variance), freedom + 1.0)
    scale = ratio_or_nan(_t_quantile(freedom) ** 2, np.minimum(worth, trials))
    middle = (value + scale / 2.0) / (1.0 + scale)
    reach = np.sqrt(np.maximum(spread * scale + scale * scale / 4.0, 0.0)) / (1.0 + scale)
    ends = np.clip(np.stack([middle - reach, middle + reach]), 0.0, 1.0)
    return np.where(np.isnan(error), np.nan, ends)


def difference_interval(
    value: ArrayLike, error: ArrayLike, *, freedom: ArrayLike, labels: ArrayLike
) -> Float[np.ndarray, "2 *shape"]:
    """Return the 95 % interval of a paired difference, one label gained and one lost added; nan if `error` is."""
    value, error, labels = (np.asarray(n, dtype=np.float64) for n in (value, error, labels))
    middle = value * labels / (labels + 2.0)
    reach = _t_quantile(freedom) * np.sqrt(error**2 + 2.0 / (labels + 2.0) ** 2)
    return np.clip(np.stack([middle - reach, middle + reach]), -1.0, 1.0)


def combined_error_and_freedom(
    tests: ArrayLike, seeds: ArrayLike, *, test_freedom: ArrayLike, seed_freedom: ArrayLike
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Return standard error from test pictures and from seeds together, and its degrees of freedom (Satterthwaite)."""
    first, second = np.asarray(tests, dtype=np.float64) ** 2, np.asarray(seeds, dtype=np.float64) ** 2
    both = first + second
    shrink = ratio_or_nan(first**2, test_freedom) + np.where(second > 0, ratio_or_nan(second**2, seed_freedom), 0.0)
    return np.asarray(np.sqrt(both)), np.where(shrink > 0, ratio_or_nan(both**2, shrink), test_freedom)


def figure_intervals(
    values: Mapping[str, ArrayLike],
    resampled: Mapping[str, Float[np.ndarray, " r"]],
    wholes: Mapping[str, Float[np.ndarray, " groups"]],
) -> dict[str, Float[np.ndarray, "2"]]:
    """Return intervals of figures from their values, those of every resample, and the denominator of each group."""
    found = {}
    for key, whole in wholes.items():
        groups = int((whole > 0).sum())
        trials = np.inf if key in MEAN_METRICS else whole.sum()
        found[key] = share_interval(
            values[key], resampled_standard_error(resampled[key], groups), freedom=groups - 1, trials=trials
        )
    return found


def _t_quantile(freedom: ArrayLike) -> Float[np.ndarray, "..."]:
    return np.asarray(stdtrit(np.maximum(freedom, 1.0), 0.5 + CONFIDENCE_LEVEL / 2))
