"""Coverage of 95 % intervals; `python -m hulldown.tests.training.test_interval_coverage` simulates the docs' table."""

import numpy as np
import pytest

from hulldown.training.evaluation.average_precision import weighted_class_ap
from hulldown.training.evaluation.bootstrap import (
    difference_interval,
    figure_intervals,
    resample_sums,
    resampled_standard_error,
    share_interval,
)
from hulldown.training.evaluation.metrics import figure_denominators, figures_from_sums

POSITIONS = (5, 10, 20, 60, 200)
TIMES = 300  # resamples
SHOTS = 1.0  # additional labels per position, on average
# Recall, agreement of images of a position, false positives per position.
SCENES = ((0.5, 0.0, 0.3), (0.5, 0.3, 0.3), (0.8, 0.3, 0.3), (0.95, 0.0, 0.3), (0.95, 0.3, 0.3))
# Recall, agreement, and the shares of misses that become hits and of hits that become misses.
CHANGES = ((0.7, 0.3, 0.05, 0.02), (0.7, 0.0, 0.1, 0.0), (0.8, 0.3, 0.2, 0.1), (0.9, 0.3, 0.1, 0.02))


def found_in(rng, labels, recall, agreement):
    if agreement == 0.0:
        return rng.binomial(labels, recall)
    each = 1.0 / agreement - 1.0
    return rng.binomial(labels, rng.beta(recall * each, (1.0 - recall) * each, labels.shape))


def sums_of(rng, labels, tp, fp):
    iou = 0.8 * tp + np.sqrt(tp) * rng.normal(0.0, 0.08, tp.shape) + tp * rng.normal(0.0, 0.03, tp.shape)
    return np.stack([tp, fp, labels - tp, iou, 0.7 * tp, 0.4 * fp], axis=-1).astype(float)


def covers(truth, ends, drawn):
    """Whether our interval holds the truth, and that of percentiles; nan without an interval."""
    if np.isnan(ends).any():
        return [np.nan, np.nan]
    return [low <= truth <= high for low, high in (ends, np.nanquantile(drawn, [0.025, 0.975]))]


def of_figures(rng, n, simulations, recall, agreement, alarms):
    """Yield whether intervals of recall, precision, F1, and mean IoU hold the truth."""
    per = 1.0 + SHOTS
    truth = figures_from_sums(np.array([per * recall, alarms, per * (1 - recall), 0.8 * per * recall, 0, 0]))
    for _ in range(simulations):
        labels = 1 + rng.poisson(SHOTS, n)
        sums = sums_of(rng, labels, found_in(rng, labels, recall, agreement), rng.poisson(alarms, n))
        again = resample_sums(sums, times=TIMES)
        drawn = figures_from_sums(again)
        ends = figure_intervals(figures_from_sums(sums.sum(axis=0)), drawn, figure_denominators(sums))
        yield [covers(truth[key], ends[key], drawn[key]) for key in ("recall", "precision", "f1", "mean_iou")]


def of_differences(rng, n, simulations, recall, agreement, gain, loss):
    """The same for the difference of recall between two detectors."""
    truth = (1.0 - recall) * gain - recall * loss
    for _ in range(simulations):
        labels = 1 + rng.poisson(SHOTS, n)
        before = found_in(rng, labels, recall, agreement)
        after = before + rng.binomial(labels - before, gain) - rng.binomial(before, loss)
        total = labels.sum()
        again = resample_sums(np.stack([after - before, labels], axis=1).astype(float), times=TIMES)
        drawn = again[:, 0] / again[:, 1]
        value, error = (after - before).sum() / total, resampled_standard_error(drawn, n)
        yield [covers(truth, difference_interval(value, error, freedom=n - 1, labels=total), drawn)]


def ranked(rng, n, recall, agreement, alarms):
    """Labels of each position, and for each detection, by falling score, whether it's true and its position."""
    labels = 1 + rng.poisson(SHOTS, n)
    tp, fp = found_in(rng, labels, recall, agreement), rng.poisson(2 * alarms, n)
    score = np.concatenate([rng.beta(4, 2, tp.sum()), rng.beta(2, 4, fp.sum())])
    true = np.repeat([True, False], [tp.sum(), fp.sum()])
    position = np.concatenate([np.repeat(np.arange(n), tp), np.repeat(np.arange(n), fp)])
    order = np.argsort(-score)
    return labels, true[order], position[order]


def ap50(labels, true, position, weights):
    once = np.ones((1, len(true)), dtype=bool)
    return weighted_class_ap(true[None], once, weights[:, position], weights @ labels)[:, 0]


def of_ap50(rng, n, simulations, *scene):
    """The same for AP50 of one class."""
    truth = ap50(*ranked(rng, 30_000, *scene), np.ones((1, 30_000)))[0]
    for k in range(simulations):
        labels, true, position = ranked(rng, n, *scene)
        drawn = np.random.default_rng(k).multinomial(n, np.ones(n) / n, size=TIMES)
        value, *again = ap50(labels, true, position, np.concatenate([np.ones((1, n)), drawn]))
        error = resampled_standard_error(np.array(again), n)
        yield [covers(truth, share_interval(value, error, freedom=n - 1, trials=labels.sum()), again)]


def lowest(simulated, cases, n, simulations, *, seed):
    """The lowest coverage in any case by (figure, way): of our intervals, and of percentiles."""
    rng = np.random.default_rng([n, seed])
    held = np.array([list(simulated(rng, n, simulations, *case)) for case in cases], dtype=float)
    known = (~np.isnan(held)).sum(axis=1)
    shares = np.where(known >= simulations / 4, np.nansum(held, axis=1) / np.maximum(known, 1), np.nan)
    return np.nanmin(shares, axis=0)


def lowest_of_all(n, simulations):
    """`lowest` of the figures in the columns of the docs' table."""
    return np.concatenate(
        [
            lowest(of_figures, SCENES, n, simulations, seed=0),
            lowest(of_ap50, SCENES, n, simulations // 4, seed=2),
            lowest(of_differences, CHANGES, n, simulations, seed=1),
        ]
    )


@pytest.mark.thorough
@pytest.mark.parametrize("n", POSITIONS)
def test_intervals_have_about_their_stated_coverage(n):
    """A measured share of 400 is rarely below 0.91 if the true one is 0.95."""
    assert lowest_of_all(n, 400)[:, 0].min() > 0.91


@pytest.mark.parametrize("n", [5, 20])
def test_a_small_simulation_shows_the_low_coverage_of_percentiles(n):
    [(ours, percentiles)] = lowest(of_differences, CHANGES, n, 60, seed=1)
    assert ours > 0.85
    assert percentiles < 0.8


if __name__ == "__main__":
    print("| positions | recall | precision | F1 | mean IoU | AP50 | difference of recall |")
    print("|---:|---:|---:|---:|---:|---:|---:|")
    for positions in POSITIONS:
        shares = [f"{ours:.2f} ({other:.2f})" for ours, other in lowest_of_all(positions, 1000)]
        print(f"| {positions} | " + " | ".join(shares) + " |")
