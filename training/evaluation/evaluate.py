"""Evaluate one detector on a dataset, and compare two."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from hulldown.training.evaluation.average_precision import (
    AP_NAMES,
    IOU_THRESHOLDS,
    coco_summary_and_class_aps,
    mean_over_classes,
    resampled_class_aps,
)
from hulldown.training.evaluation.bins import BinFigures, binned_fields, figures_by_bin
from hulldown.training.evaluation.bootstrap import (
    difference_interval,
    draw_resamples,
    figure_intervals,
    resample_sums,
    resampled_standard_error,
)
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.matching import match_at_each_iou, match_detections
from hulldown.training.evaluation.metrics import (
    COUNT_METRICS,
    DERIVED_METRICS,
    SUM_METRICS,
    figure_denominators,
    figures_from_sums,
    metric_sums_by_bin,
    threshold_curves,
)
from hulldown.training.evaluation.predictions import Predictions

AP_RESAMPLES = 400  # enough for a standard error; each passes over all detections


@dataclass(frozen=True, slots=True)
class Threshold:
    """The confidence threshold of detections, and its source."""

    value: float  # detections with at least this score count
    source: str  # ``"given"``, ``"validation"`` (the best F1 on another set), or ``"count"`` (`equal_count_threshold`)


class Evaluation:
    """The evaluation of a detector on a dataset of c classes; each property is computed on first use."""

    def __init__(self, labels: Labels, predictions: Predictions, *, threshold: Threshold, iou: float = 0.5) -> None:
        self.labels, self.predictions, self.threshold = labels, predictions, threshold
        self.matching = match_detections(labels, predictions, iou=iou)
        self.seen = self.matching.with_threshold(threshold.value)

    @cached_property
    def position_metric_sums(self) -> Float[np.ndarray, "positions c 6"]:
        """`metrics.SUM_METRICS` of each class in each position."""
        classes = len(self.predictions.class_names)
        by_class = {"of_detection": self.predictions.class_index, "of_label": self.labels.class_index}
        return metric_sums_by_bin(self.seen, **by_class, bins=classes)

    @cached_property
    def resampled_metric_sums(self) -> Float[np.ndarray, "r c 6"]:
        """`metrics.SUM_METRICS` of each class in every resample of positions."""
        return resample_sums(self.position_metric_sums)

    @cached_property
    def position_label_counts(self) -> Float[np.ndarray, " positions"]:
        """Number of labels in each position, without crowds."""
        return figure_denominators(self.position_metric_sums.sum(axis=1))["recall"]

    @property
    def summary(self) -> dict[str, float]:
        """COCO's summary of all classes."""
        return self._summary_and_class_aps[0]

    @cached_property
    def _summary_and_class_aps(self) -> tuple[dict[str, float], Float[np.ndarray, "c 3"]]:
        return coco_summary_and_class_aps(self.labels, self.predictions)

    @cached_property
    def _resampled_class_aps(self) -> Float[np.ndarray, "r c 3"]:
        matchings = match_at_each_iou(self.labels, self.predictions, IOU_THRESHOLDS)
        some = draw_resamples(self.labels.positions, times=AP_RESAMPLES)
        return np.concatenate([resampled_class_aps(matchings, weights) for weights in some])

    @cached_property
    def bins(self) -> list[BinFigures]:
        """Figures in the bins of each field."""
        return [figures_by_bin(field, self.seen) for field in binned_fields(self.labels, self.predictions)]

    def values(self, label: int | None = None) -> dict[str, float]:
        """Return counts, derived metrics, and `AP_NAMES`, over all classes or of one; nan if undefined."""
        sums = self.position_metric_sums[:, _class_slice(label)].sum(axis=0).sum(axis=0)
        summary, of_classes = self._summary_and_class_aps
        averages = [summary[key] for key in AP_NAMES] if label is None else of_classes[label]
        found = {
            **dict(zip(SUM_METRICS, sums, strict=True)),
            **figures_from_sums(sums),
            **dict(zip(AP_NAMES, averages, strict=True)),
        }
        return {key: float(found[key]) for key in (*COUNT_METRICS, *DERIVED_METRICS, *AP_NAMES)}

    def resampled_metrics(self, label: int | None = None) -> dict[str, Float[np.ndarray, " r"]]:
        """`metrics.DERIVED_METRICS` in every resample of positions, and `AP_NAMES` in `AP_RESAMPLES` resamples."""
        averages = mean_over_classes(self._resampled_class_aps[:, _class_slice(label)])
        found = figures_from_sums(self.resampled_metric_sums[:, _class_slice(label)].sum(axis=1))
        return found | dict(zip(AP_NAMES, averages.T, strict=True))

    def intervals(self, label: int | None = None) -> dict[str, Float[np.ndarray, "2"]]:
        """Return intervals of all figures, over all classes or of one."""
        wholes = figure_denominators(self.position_metric_sums[:, _class_slice(label)].sum(axis=1))
        wholes |= dict.fromkeys(AP_NAMES, wholes["recall"])
        return figure_intervals(self.values(label), self.resampled_metrics(label), wholes)


def _class_slice(label: int | None) -> slice:
    return slice(None) if label is None else slice(label, label + 1)


@dataclass(frozen=True, eq=False, slots=True)
class DetectorComparison:
    """Differences of two detectors, second minus first, on one dataset."""

    first: str
    second: str
    difference: dict[str, float]
    intervals: dict[str, Float[np.ndarray, "2"]]


def best_threshold(labels: Labels, predictions: Predictions, *, iou: float = 0.5) -> float | None:
    """Return the highest confidence with the highest F1 over all classes; None without detections."""
    curve = threshold_curves(match_detections(labels, predictions, iou=iou))
    return float(curve["threshold"][np.argmax(curve["f1"])]) if len(curve["f1"]) else None


def equal_count_threshold(labels: Labels, predictions: Predictions) -> float:
    """Return the confidence that as many detections reach as there are labels; 0 if there are fewer detections."""
    wanted = int((~labels.crowd).sum())
    return float(np.sort(predictions.score)[-wanted]) if 0 < wanted <= len(predictions.score) else 0.0


def compare_detectors(first: Evaluation, second: Evaluation) -> DetectorComparison:
    """Compare two detectors on one dataset, second minus first, on the same resamples of positions."""
    before, after = first.values(), second.values()
    again, later = first.resampled_metrics(), second.resampled_metrics()
    labels = first.position_label_counts
    positions = int((labels > 0).sum())
    difference = {key: after[key] - before[key] for key in again}
    intervals = {
        key: difference_interval(
            value, resampled_standard_error(later[key] - again[key], positions), freedom=positions - 1, labels=labels.sum()
        )
        for key, value in difference.items()
    }
    return DetectorComparison(first.predictions.name, second.predictions.name, difference, intervals)
