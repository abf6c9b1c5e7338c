"""Everything that is to be said about the detections of one detector, and about the difference between two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from training.average_precision import AveragePrecision, official
from training.bins import BinFigures, figures_of
from training.bootstrap import difference_intervals, figure_intervals, interval, resampled_sums
from training.fields import fields
from training.labels import Labels
from training.matching import Matching, Pairs, match, overlapping
from training.metrics import Curves, Outcomes, confusion, curves, figures, outcomes, sums_by
from training.predictions import Predictions
from training.resampled_precision import AVERAGES, IOUS, resampled_averages
from training.tide import BACKGROUND, Errors, errors

FOREGROUND = 0.5  # the IoU of AP50 and of the causes of errors, whatever that of the counts
MOST_RESAMPLED = 100_000  # detections up to which AP gets intervals: its resampling goes through all, 2,000 times


@dataclass(frozen=True, slots=True)
class Threshold:
    """The confidence from which detections count, and where it comes from.

    Parameters
    ----------
    value
        Scores of at least this count.
    source
        ``"given"``, ``"validation"`` (the best F1 on another set) or ``"test"`` (the best F1 on the set itself, which
        flatters).
    """

    value: float
    source: str


@dataclass(frozen=True, eq=False, slots=True)
class Evaluation:
    """What is known about one detector's detections in a dataset of c classes.

    Parameters
    ----------
    labels, predictions, pairs
        What was compared.
    threshold
        The operating point; its IoU is the matching's.
    matching, seen
        What became of each detection and label.
    positions
        How many independent positions the images show.
    sums
        (c, 6) `metrics.SUMS` of each class.
    resampled
        (r, c, 6) the same of every drawing of positions.
    average
        AP and AR by pycocotools.
    averages_resampled
        (r, c, 3) `resampled_precision.AVERAGES` of every drawing; None beyond `MOST_RESAMPLED` detections.
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
    pairs: Pairs
    threshold: Threshold
    matching: Matching
    seen: Outcomes
    positions: int
    sums: Float[np.ndarray, "c 6"]
    resampled: Float[np.ndarray, "r c 6"]
    average: AveragePrecision
    averages_resampled: Float[np.ndarray, "r c 3"] | None
    errors: Errors
    curves: Curves
    class_curves: tuple[Curves, ...]
    confusion: Int[np.ndarray, "k k"]
    bins: list[BinFigures]

    def intervals(self) -> dict[str, Float[np.ndarray, "2"]]:
        """Of all figures, over all classes."""
        found = figure_intervals(self.resampled.sum(axis=1))
        if self.averages_resampled is not None:
            found |= _named(interval(_mean(self.averages_resampled)))
        return found

    def class_intervals(self, label: int) -> dict[str, Float[np.ndarray, "2"]]:
        """Of all figures of one class."""
        found = figure_intervals(self.resampled[:, label])
        if self.averages_resampled is not None:
            found |= _named(interval(self.averages_resampled[:, label]))
        return found


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
    sums = sums_by(
        labels,
        predictions,
        matching,
        seen,
        of_detection=position[predictions.image] * classes + predictions.label,
        of_label=position[labels.image] * classes + labels.label,
        groups=positions * classes,
    ).reshape(positions, classes, 6)
    return Evaluation(
        labels=labels,
        predictions=predictions,
        pairs=pairs,
        threshold=threshold,
        matching=matching,
        seen=seen,
        positions=positions,
        sums=sums.sum(axis=0),
        resampled=resampled_sums(sums),
        average=official(labels, predictions),
        averages_resampled=_averages(labels, predictions, pairs, position),
        errors=errors(labels, predictions, pairs, at_half),
        curves=curves(labels, predictions, matching),
        class_curves=tuple(curves(labels, predictions, matching, label=c) for c in range(classes)),
        confusion=confusion(labels, predictions, pairs, matching, seen),
        bins=[figures_of(field, labels, predictions, matching, seen) for field in fields(labels, predictions)],
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
    before, after = (figures(one.sums.sum(axis=0)) for one in (first, second))
    difference = {key: float(after[key] - before[key]) for key in before}
    ends = difference_intervals(first.resampled.sum(axis=1), second.resampled.sum(axis=1))
    difference |= {key: second.average.summary[key] - first.average.summary[key] for key in AVERAGES}
    if first.averages_resampled is not None and second.averages_resampled is not None:
        ends |= _named(interval(_mean(second.averages_resampled) - _mean(first.averages_resampled)))
    return Comparison(first.predictions.name, second.predictions.name, difference, ends)


def _averages(
    labels: Labels, predictions: Predictions, pairs: Pairs, position: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "r c 3"] | None:
    """AP, AP50 and AP75 of every drawing of positions."""
    if len(predictions.score) > MOST_RESAMPLED:
        return None
    among = pairs.where(pairs.iou >= IOUS[0])
    matchings = [match(labels, predictions, among, iou=iou) for iou in IOUS]
    return resampled_averages(labels, predictions, matchings, position)


def _mean(each: Float[np.ndarray, "r c 3"]) -> Float[np.ndarray, "r 3"]:
    """The mean over classes that have labels, as COCO takes it; nan where none has."""
    known = ~np.isnan(each)
    counts = known.sum(axis=1)
    total = np.where(known, each, 0.0).sum(axis=1)
    return np.divide(total, counts, out=np.full(total.shape, np.nan), where=counts > 0)


def _named(ends: Float[np.ndarray, "2 3"]) -> dict[str, Float[np.ndarray, "2"]]:
    return {key: ends[:, k] for k, key in enumerate(AVERAGES)}
