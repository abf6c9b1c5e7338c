"""Evaluate one detector on a dataset, and compare two."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from hulldown.training.evaluation.average_precision import (
    AVERAGES,
    IOUS,
    AveragePrecision,
    average_precision,
    class_mean,
    oriented_average,
    resampled_averages,
)
from hulldown.training.evaluation.bins import BinFigures, fields, figures_of
from hulldown.training.evaluation.bootstrap import (
    difference_interval,
    figure_intervals,
    resampled_sums,
    resamples,
    share_interval,
    standard_error,
)
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.matching import Matching, match, overlapping
from hulldown.training.evaluation.metrics import (
    SUMS,
    Curves,
    confusion,
    curves,
    figures,
    outcomes,
    sums_at_best,
    sums_by,
)
from hulldown.training.evaluation.predictions import Predictions
from hulldown.training.evaluation.tide import BACKGROUND, Errors, errors

FOREGROUND = 0.5  # IoU of AP50 and of the causes of errors, independent of the counts' IoU
AP_RESAMPLES = 400  # enough for a standard error; each passes over all detections


@dataclass(frozen=True, slots=True)
class Threshold:
    """The confidence threshold of detections, and its source.

    Parameters
    ----------
    value
        Detections with at least this score count.
    source
        ``"given"``, ``"validation"`` (the best F1 on another set), or ``"test"``: the best F1 on the set itself, which
        makes every figure at the threshold too good. Each resample then chooses its own.
    """

    value: float
    source: str


class Evaluation:
    """The evaluation of a detector on a dataset of c classes; each property is computed on first use.

    Parameters
    ----------
    labels, predictions
        Ground truth and detections.
    threshold
        The confidence threshold.
    iou
        Least IoU of a match.
    """

    def __init__(self, labels: Labels, predictions: Predictions, *, threshold: Threshold, iou: float = 0.5) -> None:
        self.labels, self.predictions, self.threshold = labels, predictions, threshold
        pairs = overlapping(labels, predictions, at_least=min(BACKGROUND, iou))
        self.matching = match(labels, predictions, pairs, iou=iou)
        self.seen = outcomes(self.matching, threshold.value)
        self.positions = labels.positions
        self._classes = len(predictions.class_names)

    @cached_property
    def position_sums(self) -> Float[np.ndarray, "positions c 6"]:
        """`metrics.SUMS` of each class in each position."""
        return sums_by(self.seen, of_detection=self.predictions.label, of_label=self.labels.label, bins=self._classes)

    @cached_property
    def sums(self) -> Float[np.ndarray, "c 6"]:
        """`metrics.SUMS` of each class."""
        return self.position_sums.sum(axis=0)

    @cached_property
    def label_positions(self) -> Int[np.ndarray, "positions c"]:
        """Number of labels of each class in each position, without crowds."""
        return self.position_sums[:, :, [SUMS.index("tp"), SUMS.index("fn")]].sum(axis=2).astype(np.int64)

    @cached_property
    def resampled(self) -> Float[np.ndarray, "r c 6"]:
        """`metrics.SUMS` of each class in every resample of positions."""
        if self.threshold.source != "test":
            return resampled_sums(self.position_sums)
        return np.concatenate([sums_at_best(self.matching, weights) for weights in resamples(self.positions)])

    @cached_property
    def average(self) -> AveragePrecision:
        """AP and AR."""
        if self.predictions.corners is not None:
            return oriented_average(self._matchings)
        return average_precision(self.labels, self.predictions)

    @cached_property
    def _matchings(self) -> list[Matching]:
        among = self.matching.pairs.where(self.matching.pairs.iou >= IOUS[0])
        return [match(self.labels, self.predictions, among, iou=iou) for iou in IOUS]

    @cached_property
    def averages_resampled(self) -> Float[np.ndarray, "r c 3"]:
        """`average_precision.AVERAGES` of every resample of positions."""
        some = resamples(self.positions, times=AP_RESAMPLES)
        return np.concatenate([resampled_averages(self._matchings, weights) for weights in some])

    @cached_property
    def errors(self) -> Errors:
        """Causes of errors, at an IoU of 0.5."""
        return errors(match(self.labels, self.predictions, self.matching.pairs, iou=FOREGROUND))

    @cached_property
    def curves(self) -> Curves:
        """Of all classes together."""
        return curves(self.matching)

    @cached_property
    def class_curves(self) -> tuple[Curves, ...]:
        """Of each class."""
        return tuple(curves(self.matching, label=c) for c in range(self._classes))

    @cached_property
    def confusion(self) -> Int[np.ndarray, "k k"]:
        """(c + 1, c + 1) true class by detected class, background last."""
        return confusion(self.seen)

    @cached_property
    def bins(self) -> list[BinFigures]:
        """Figures in the bins of each field."""
        return [figures_of(field, self.seen) for field in fields(self.labels, self.predictions)]

    def intervals(self, label: int | None = None) -> dict[str, Float[np.ndarray, "2"]]:
        """Of all figures, over all classes or of one."""
        one = slice(None) if label is None else slice(label, label + 1)
        found = figure_intervals(self.position_sums[:, one].sum(axis=1), self.resampled[:, one].sum(axis=1))
        average, labels = self.average, self.label_positions[:, one].sum(axis=1)
        value = [average.summary[key] for key in AVERAGES] if label is None else average.each[label]
        positions = int((labels > 0).sum())
        error = standard_error(class_mean(self.averages_resampled[:, one]), positions)
        ends = share_interval(value, error, freedom=positions - 1, trials=labels.sum())
        return found | {key: ends[:, k] for k, key in enumerate(AVERAGES)}


@dataclass(frozen=True, eq=False, slots=True)
class DetectorComparison:
    """Differences of two detectors, second minus first, on one dataset.

    Parameters
    ----------
    first, second
        Their names.
    difference, intervals
        By figure.
    """

    first: str
    second: str
    difference: dict[str, float]
    intervals: dict[str, Float[np.ndarray, "2"]]


def best_threshold(labels: Labels, predictions: Predictions, *, iou: float = 0.5) -> float | None:
    """The confidence with the highest F1 over all classes; None without detections."""
    pairs = overlapping(labels, predictions, at_least=iou)
    return curves(match(labels, predictions, pairs, iou=iou)).best()


def compare(first: Evaluation, second: Evaluation) -> DetectorComparison:
    """Compare two detectors, second minus first, on the same resamples of positions.

    Raises
    ------
    ValueError
        If they're of different datasets.
    """
    if first.labels is not second.labels:
        raise ValueError(f"second: expected an evaluation on {first.labels.path}, got {second.labels.path}")
    positions = int((first.label_positions.sum(axis=1) > 0).sum())
    labels = int(first.label_positions.sum())
    value, error = {}, {}
    before, after = (figures(one.sums.sum(axis=0)) for one in (first, second))
    again = [figures(one.resampled.sum(axis=1)) for one in (first, second)]
    for key in before:
        value[key] = float(after[key] - before[key])
        error[key] = standard_error(again[1][key] - again[0][key], positions)
    averages = standard_error(class_mean(second.averages_resampled) - class_mean(first.averages_resampled), positions)
    for k, key in enumerate(AVERAGES):
        value[key] = second.average.summary[key] - first.average.summary[key]
        error[key] = averages[k]
    ends = {key: difference_interval(value[key], error[key], freedom=positions - 1, labels=labels) for key in value}
    return DetectorComparison(first.predictions.name, second.predictions.name, value, ends)
