"""Evaluate one detector on a dataset, and compare two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from hulldown.training.evaluation.average_precision import (
    AVERAGES,
    IOUS,
    AveragePrecision,
    average_precision,
    class_mean,
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
from hulldown.training.evaluation.matching import Matching, Pairs, match, overlapping
from hulldown.training.evaluation.metrics import (
    Curves,
    Outcomes,
    confusion,
    curves,
    figures,
    outcomes,
    sums_at_best,
    sums_by,
)
from hulldown.training.evaluation.predictions import Predictions
from hulldown.training.evaluation.tide import BACKGROUND, Errors, errors

FOREGROUND = 0.5  # the IoU of AP50 and of the causes of errors, whatever that of the counts
AP_RESAMPLES = 400  # a standard error needs no more, and each goes through all detections


@dataclass(frozen=True, slots=True)
class Threshold:
    """The confidence from which detections count, and where it comes from.

    Parameters
    ----------
    value
        Scores of at least this count.
    source
        ``"given"``, ``"validation"`` (the best F1 on another set) or ``"test"``: the best F1 on the set itself, which
        makes every figure at the threshold too good. Each resample then chooses its own.
    """

    value: float
    source: str


@dataclass(frozen=True, eq=False, slots=True)
class Evaluation:
    """What is known about one detector's detections in a dataset of c classes.

    Parameters
    ----------
    labels, predictions
        What was compared.
    threshold
        The operating point; its IoU is the matching's.
    matching, seen
        What became of each detection and label.
    position_sums
        (positions, c, 6) `metrics.SUMS` of each class in each position.
    label_positions
        (positions, c) labels of each class in each position, crowds left out.
    resampled
        (r, c, 6) `metrics.SUMS` of each class in every resample of positions.
    average
        AP and AR.
    averages_resampled
        (r, c, 3) `average_precision.AVERAGES` of every resample.
    errors
        Causes, at an IoU of 0.5.
    curves
        Of all classes together.
    class_curves
        Of each class.
    confusion
        (c + 1, c + 1) true class by detected class, background last.
    bins
        Figures by what is known about labels.
    """

    labels: Labels
    predictions: Predictions
    threshold: Threshold
    matching: Matching
    seen: Outcomes
    position_sums: Float[np.ndarray, "positions c 6"]
    label_positions: Int[np.ndarray, "positions c"]
    resampled: Float[np.ndarray, "r c 6"]
    average: AveragePrecision
    averages_resampled: Float[np.ndarray, "r c 3"]
    errors: Errors
    curves: Curves
    class_curves: tuple[Curves, ...]
    confusion: Int[np.ndarray, "k k"]
    bins: list[BinFigures]

    @property
    def positions(self) -> int:
        """How many independent positions the images show."""
        return len(self.position_sums)

    @property
    def sums(self) -> Float[np.ndarray, "c 6"]:
        """`metrics.SUMS` of each class."""
        return self.position_sums.sum(axis=0)

    def intervals(self, label: int | None = None) -> dict[str, Float[np.ndarray, "2"]]:
        """Of all figures, over all classes or of one."""
        one = slice(None) if label is None else slice(label, label + 1)
        found = figure_intervals(self.position_sums[:, one].sum(axis=1), self.resampled[:, one].sum(axis=1))
        average, labels = self.average, self.label_positions[:, one].sum(axis=1)
        value = [average.summary[key] if label is None else getattr(average, key)[label] for key in AVERAGES]
        positions = int((labels > 0).sum())
        error = standard_error(class_mean(self.averages_resampled[:, one]), positions)
        ends = share_interval(value, error, freedom=positions - 1, trials=labels.sum())
        return found | {key: ends[:, k] for k, key in enumerate(AVERAGES)}


@dataclass(frozen=True, eq=False, slots=True)
class Comparison:
    """Second minus first, on one dataset.

    Parameters
    ----------
    first, second
        Names of the two.
    difference, interval
        By figure.
    """

    first: str
    second: str
    difference: dict[str, float]
    interval: dict[str, Float[np.ndarray, "2"]]


def evaluate(labels: Labels, predictions: Predictions, *, threshold: Threshold, iou: float = 0.5) -> Evaluation:
    """Judge detections.

    Parameters
    ----------
    labels, predictions
        What was to be found, and what was found.
    threshold
        The confidence from which detections count.
    iou
        The overlap from which a detection has found a label of its class.
    """
    classes = len(predictions.class_names)
    pairs = overlapping(labels, predictions, at_least=min(BACKGROUND, iou))
    matching = match(labels, predictions, pairs, iou=iou)
    at_half = matching if iou == FOREGROUND else match(labels, predictions, pairs, iou=FOREGROUND)
    seen = outcomes(labels, predictions, matching, threshold.value)
    position = labels.positions()
    positions = int(position.max()) + 1 if len(position) else 0
    of_label = position[labels.image] * classes + labels.label
    position_sums = sums_by(
        labels,
        predictions,
        matching,
        seen,
        of_detection=position[predictions.image] * classes + predictions.label,
        of_label=of_label,
        groups=positions * classes,
    ).reshape(positions, classes, 6)
    label_positions = np.bincount(of_label[~labels.crowd], minlength=positions * classes).reshape(positions, classes)
    if threshold.source == "test" and positions:
        chosen = [
            sums_at_best(labels, predictions, matching, position=position, weights=weights)
            for weights in resamples(positions)
        ]
        resampled = np.concatenate(chosen)
    else:
        resampled = resampled_sums(position_sums)
    return Evaluation(
        labels=labels,
        predictions=predictions,
        threshold=threshold,
        matching=matching,
        seen=seen,
        position_sums=position_sums,
        label_positions=label_positions,
        resampled=resampled,
        average=average_precision(labels, predictions),
        averages_resampled=_averages(labels, predictions, pairs, position),
        errors=errors(labels, predictions, pairs, at_half),
        curves=curves(labels, predictions, matching),
        class_curves=tuple(curves(labels, predictions, matching, label=c) for c in range(classes)),
        confusion=confusion(labels, predictions, pairs, matching, seen),
        bins=[
            figures_of(field, labels, predictions, matching, seen, position=position)
            for field in fields(labels, predictions)
        ],
    )


def best_threshold(labels: Labels, predictions: Predictions, *, iou: float = 0.5) -> float | None:
    """The confidence of the highest F1 over all classes; None without detections."""
    pairs = overlapping(labels, predictions, at_least=iou)
    return curves(labels, predictions, match(labels, predictions, pairs, iou=iou)).best()


def compare(first: Evaluation, second: Evaluation) -> Comparison:
    """Second minus first, position by position: both have seen the same drawings.

    Raises
    ------
    ValueError
        If they are not of one dataset.
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
    return Comparison(first.predictions.name, second.predictions.name, value, ends)


def _averages(
    labels: Labels, predictions: Predictions, pairs: Pairs, position: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "r c 3"]:
    """AP, AP50 and AP75 of every resample of positions."""
    positions = int(position.max()) + 1 if len(position) else 0
    if not positions:
        return np.full((AP_RESAMPLES, len(predictions.class_names), len(AVERAGES)), np.nan)
    among = pairs.where(pairs.iou >= IOUS[0])
    matchings = [match(labels, predictions, among, iou=iou) for iou in IOUS]
    parts = [
        resampled_averages(labels, predictions, matchings, position=position, weights=weights)
        for weights in resamples(positions, times=AP_RESAMPLES)
    ]
    return np.concatenate(parts)
