"""The paper's figures (section 2.3): counts, precision, recall, F1, mean IoU and confidence; and curves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from hulldown.training.evaluation.matching import Matching, match_detections

COUNT_METRICS = ("tp", "fp", "fn")
SUM_METRICS = (*COUNT_METRICS, "iou", "confidence_tp", "confidence_fp")  # they add up over images
RATIO_METRICS = ("precision", "recall", "f1")  # of counts
MEAN_METRICS = ("mean_iou", "mean_confidence", "mean_confidence_tp", "mean_confidence_fp")
DERIVED_METRICS = (*RATIO_METRICS, *MEAN_METRICS)


def metric_sums_by_bin(
    matching: Matching, *, of_detection: Int[np.ndarray, " d"], of_label: Int[np.ndarray, " g"], bins: int
) -> Float[np.ndarray, "positions bins 6"]:
    """Return `SUM_METRICS` of each bin in each position."""
    labels, predictions, true, false = matching.labels, matching.predictions, matching.true, matching.false

    def totals(of: np.ndarray, image: np.ndarray, *weights: np.ndarray) -> list[np.ndarray]:
        inside = of >= 0
        cell = labels.position[image[inside]] * bins + of[inside]
        return [np.bincount(cell, weights=weight[inside], minlength=labels.positions * bins) for weight in weights]

    means = ((true, matching.iou), (true, predictions.score), (false, predictions.score))
    weights = (np.where(counted, value, 0.0) for counted, value in means)
    tp, fp, *rest = totals(of_detection, predictions.image, true, false, *weights)
    fn = totals(of_label, labels.image, matching.missed)
    return np.stack([tp, fp, *fn, *rest], axis=1, dtype=np.float64).reshape(labels.positions, bins, len(SUM_METRICS))


def figures_from_sums(sums: Float[np.ndarray, "*batch 6"]) -> dict[str, Float[np.ndarray, "*batch"]]:
    """Return `DERIVED_METRICS` from `SUM_METRICS` in the last axis; nan if undefined."""
    tp, _, _, iou, sure_tp, sure_fp = np.moveaxis(np.asarray(sums, dtype=np.float64), -1, 0)
    parts = (tp, tp, 2.0 * tp, iou, sure_tp + sure_fp, sure_tp, sure_fp)
    return {key: ratio_or_nan(part, whole) for part, (key, whole) in zip(parts, figure_denominators(sums).items(), strict=True)}


def figure_denominators(sums: Float[np.ndarray, "*batch 6"]) -> dict[str, Float[np.ndarray, "*batch"]]:
    """Return the denominators of `DERIVED_METRICS`."""
    tp, fp, fn = np.moveaxis(np.asarray(sums, dtype=np.float64), -1, 0)[:3]
    each = map(np.asarray, (tp + fp, tp + fn, 2.0 * tp + fp + fn, tp, tp + fp, tp, fp))
    return dict(zip(DERIVED_METRICS, each, strict=True))


def ratio_or_nan(part: ArrayLike, whole: ArrayLike) -> Float[np.ndarray, "..."]:
    """Return `part / whole`; nan if the whole is 0."""
    part, whole = np.asarray(part, dtype=np.float64), np.asarray(whole, dtype=np.float64)
    return np.divide(part, whole, out=np.full(np.broadcast(part, whole).shape, np.nan), where=whole != 0.0)


def threshold_curves(matching: Matching, *, label: int | None = None) -> dict[str, Float[np.ndarray, " k"]]:
    """Return ``precision``, ``recall``, and ``f1`` at k falling values of ``threshold``, of a class or of all."""
    labels, score = matching.labels, matching.predictions.score
    counted, wanted = ~matching.ignored, ~labels.crowd
    if label is not None:
        counted, wanted = counted & (matching.predictions.class_index == label), wanted & (labels.class_index == label)
    rows = np.flatnonzero(counted)
    rows = rows[np.argsort(-score[rows], kind="stable")]
    last = np.flatnonzero(np.diff(score[rows], append=np.nan) != 0.0)  # the last detection of each score
    tp = np.cumsum(matching.true[rows])[last]
    fp, fn = last + 1 - tp, int(wanted.sum()) - tp
    return {
        "threshold": score[rows][last],
        "precision": ratio_or_nan(tp, tp + fp),
        "recall": ratio_or_nan(tp, tp + fn),
        "f1": ratio_or_nan(2 * tp, 2 * tp + fp + fn),
    }


def confusion_matrix(matching: Matching) -> Int[np.ndarray, "k k"]:
    """Return rows of true, columns of detected classes, background last; false positives match any class's labels."""
    labels, predictions = matching.labels, matching.predictions
    background = len(predictions.class_names)
    counted, missed = ~matching.ignored, matching.missed
    wrong = np.flatnonzero(matching.false)
    wrong = wrong[np.lexsort((-predictions.score[wrong], predictions.image[wrong]))]
    turned = None if predictions.corners is None else predictions.corners[wrong]
    rest = replace(
        predictions, image=predictions.image[wrong], class_index=np.zeros_like(wrong), xywh=predictions.xywh[wrong],
        score=predictions.score[wrong], corners=turned,
    )  # fmt: skip
    # Found labels and crowds are of another class, so nothing matches them.
    others = replace(labels, class_index=np.where(missed, 0, 1))
    mixed = match_detections(others, rest, iou=matching.iou_threshold).box
    meant = np.where(matching.true, predictions.class_index, background)
    meant[wrong[mixed >= 0]] = labels.class_index[mixed[mixed >= 0]]
    missed[mixed[mixed >= 0]] = False
    rows = np.concatenate([meant[counted], labels.class_index[missed]])
    columns = np.concatenate([predictions.class_index[counted], np.full(missed.sum(), background)])
    cells = np.bincount(rows * (background + 1) + columns, minlength=(background + 1) ** 2)
    return cells.reshape(background + 1, background + 1)
