"""The paper's figures at an operating point: counts, precision, recall, F1, mean IoU, mean confidence; and curves.

References
----------
Paper, section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.matching import Matching, Overlaps, greedy
from hulldown.training.evaluation.predictions import Predictions

SUMS = ("tp", "fp", "fn", "iou", "confidence_tp", "confidence_fp")  # quantities that add up over images
FIGURES = ("precision", "recall", "f1", "mean_iou", "mean_confidence", "mean_confidence_tp", "mean_confidence_fp")
SHARES = ("precision", "recall", "f1")  # figures that are ratios of counts; the others are means


@dataclass(frozen=True, eq=False, slots=True)
class Outcomes:
    """Outcomes of detections and labels at a confidence threshold.

    Parameters
    ----------
    true
        (d,) true positives.
    false
        (d,) false positives.
    found, missed
        (g,) found and missed labels; a crowd is neither.
    """

    true: Bool[np.ndarray, " d"]
    false: Bool[np.ndarray, " d"]
    found: Bool[np.ndarray, " g"]
    missed: Bool[np.ndarray, " g"]


def outcomes(labels: Labels, predictions: Predictions, matching: Matching, threshold: float) -> Outcomes:
    """Outcomes of detections with scores of at least `threshold`."""
    counted = (predictions.score >= threshold) & ~matching.ignored
    found = np.zeros(len(labels.label), dtype=bool)
    matched = matching.detection >= 0
    found[matched] = counted[matching.detection[matched]]
    return Outcomes(
        true=counted & (matching.box >= 0),
        false=counted & (matching.box < 0),
        found=found,
        missed=~found & ~labels.crowd,
    )


def sums_by(
    predictions: Predictions,
    matching: Matching,
    seen: Outcomes,
    *,
    of_detection: Int[np.ndarray, " d"],
    of_label: Int[np.ndarray, " g"],
    groups: int,
) -> Float[np.ndarray, "groups 6"]:
    """`SUMS` of each group.

    Parameters
    ----------
    of_detection, of_label
        (d,), (g,) group of each; negative groups are ignored.
    groups
        Number of groups.
    """

    def total(group: np.ndarray, weight: np.ndarray) -> np.ndarray:
        inside = group >= 0
        return np.bincount(group[inside], weights=weight[inside], minlength=groups).astype(np.float64)

    return np.stack(
        [
            total(of_detection, seen.true),
            total(of_detection, seen.false),
            total(of_label, seen.missed),
            total(of_detection, np.where(seen.true, matching.iou, 0.0)),
            total(of_detection, np.where(seen.true, predictions.score, 0.0)),
            total(of_detection, np.where(seen.false, predictions.score, 0.0)),
        ],
        axis=1,
    )


def figures(sums: Float[np.ndarray, "*batch 6"]) -> dict[str, Float[np.ndarray, "*batch"]]:
    """`FIGURES` from `SUMS` in the last axis; nan if undefined.

    Examples
    --------
    The paper's Figure 9, real images alone, in percent:

    >>> import numpy as np
    >>> found = figures(np.array([688.0, 49, 391, 0, 0, 0]))
    >>> [round(100 * float(found[key]), 1) for key in ("precision", "recall", "f1")]
    [93.4, 63.8, 75.8]
    """
    tp, _, _, iou, sure_tp, sure_fp = np.moveaxis(np.asarray(sums, dtype=np.float64), -1, 0)
    parts = (tp, tp, 2.0 * tp, iou, sure_tp + sure_fp, sure_tp, sure_fp)
    return {key: ratio(part, whole) for part, (key, whole) in zip(parts, denominators(sums).items(), strict=True)}


def denominators(sums: Float[np.ndarray, "*batch 6"]) -> dict[str, Float[np.ndarray, "*batch"]]:
    """Denominators of `FIGURES`."""
    tp, fp, fn = np.moveaxis(np.asarray(sums, dtype=np.float64), -1, 0)[:3]
    return dict(zip(FIGURES, (tp + fp, tp + fn, 2.0 * tp + fp + fn, tp, tp + fp, tp, fp), strict=True))


def ratio(part: ArrayLike, whole: ArrayLike) -> Float[np.ndarray, "..."]:
    """`part / whole`, nan if the whole is 0."""
    part, whole = np.asarray(part, dtype=np.float64), np.asarray(whole, dtype=np.float64)
    return np.divide(part, whole, out=np.full(np.broadcast(part, whole).shape, np.nan), where=whole != 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Curves:
    """Precision, recall, and F1 over k confidence thresholds: all scores, falling.

    Parameters
    ----------
    threshold, precision, recall, f1
        (k,) each.
    """

    threshold: Float[np.ndarray, " k"]
    precision: Float[np.ndarray, " k"]
    recall: Float[np.ndarray, " k"]
    f1: Float[np.ndarray, " k"]

    def best(self) -> float | None:
        """The highest threshold with the highest F1; None without detections."""
        if not len(self.f1) or np.isnan(self.f1).all():
            return None
        return float(self.threshold[int(np.nanargmax(self.f1))])


def curves(labels: Labels, predictions: Predictions, matching: Matching, *, label: int | None = None) -> Curves:
    """Curves over the threshold, of one class or of all."""
    counted = ~matching.ignored
    wanted = ~labels.crowd
    if label is not None:
        counted, wanted = counted & (predictions.label == label), wanted & (labels.label == label)
    score, true = predictions.score[counted], (matching.box >= 0)[counted]
    order = np.argsort(-score, kind="stable")
    score, tp = score[order], np.cumsum(true[order])
    last = np.concatenate([score[1:] != score[:-1], [True]]) if len(score) else np.zeros(0, dtype=bool)
    tp, fp = tp[last], (np.arange(1, len(score) + 1) - tp)[last]
    fn = int(wanted.sum()) - tp
    return Curves(score[last], ratio(tp, tp + fp), ratio(tp, tp + fn), ratio(2 * tp, 2 * tp + fp + fn))


def confusion(
    labels: Labels, predictions: Predictions, pairs: Overlaps, matching: Matching, seen: Outcomes
) -> Int[np.ndarray, "k k"]:
    """The confusion matrix: rows are true classes, columns detected ones, the last of each is the background.

    The diagonal has the true positives. The rest is matched again, ignoring classes, by the same rule; what
    remains is background.
    """
    classes = len(predictions.class_names)
    left = pairs.where(
        seen.false[pairs.detection] & seen.missed[pairs.box] & (pairs.iou >= min(matching.iou_threshold, 1.0 - 1e-10))
    )
    mixed = greedy(left, -predictions.score, predictions.image, labels.crowd)
    false, missed = seen.false.copy(), seen.missed.copy()
    false[mixed.detection], missed[mixed.box] = False, False
    rows = [predictions.label[seen.true], labels.label[mixed.box], np.full(false.sum(), classes), labels.label[missed]]
    columns = [
        predictions.label[seen.true],
        predictions.label[mixed.detection],
        predictions.label[false],
        np.full(missed.sum(), classes),
    ]
    cells = np.concatenate(rows) * (classes + 1) + np.concatenate(columns)
    return np.bincount(cells, minlength=(classes + 1) ** 2).reshape(classes + 1, classes + 1)


def sums_at_best(
    labels: Labels,
    predictions: Predictions,
    matching: Matching,
    *,
    position: Int[np.ndarray, " n"],
    weights: Float[np.ndarray, "r positions"],
) -> Float[np.ndarray, "r c 6"]:
    """`SUMS` of each class in each resample of positions, at the threshold of the best F1 in that resample.

    Parameters
    ----------
    position
        (n,) position of each image.
    weights
        Count of each position in each resample.
    """
    classes = len(predictions.class_names)
    rows = np.flatnonzero(~matching.ignored)
    rows = rows[np.argsort(-predictions.score[rows], kind="stable")]
    score, label, true = predictions.score[rows], predictions.label[rows], matching.box[rows] >= 0
    last = np.flatnonzero(np.append(score[1:] != score[:-1], True)[: len(rows)])  # of each threshold
    iou, where = np.where(true, matching.iou[rows], 0.0), position[predictions.image[rows]]
    wanted = np.flatnonzero(~labels.crowd)
    result = np.zeros((len(weights), classes, len(SUMS)))
    for k, weight in enumerate(weights):
        per_class = np.bincount(labels.label[wanted], weights=weight[position[labels.image[wanted]]], minlength=classes)
        counts = weight[where]
        if len(last):
            f1 = ratio(2.0 * np.cumsum(counts * true)[last], np.cumsum(counts)[last] + per_class.sum())
            best = last[np.argmax(np.nan_to_num(f1))] + 1
            right, wrong = (counts * true)[:best], (counts * ~true)[:best]
            columns = (right, wrong, None, right * iou[:best], right * score[:best], wrong * score[:best])
            for column, values in enumerate(columns):
                if values is not None:
                    result[k, :, column] = np.bincount(label[:best], weights=values, minlength=classes)
        result[k, :, 2] = per_class - result[k, :, 0]
    return result
