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

from training.labels import Labels
from training.matching import Matching, Pairs, greedy
from training.predictions import Predictions

SUMS = ("tp", "fp", "fn", "iou", "confidence_tp", "confidence_fp")  # what adds up over images
FIGURES = ("precision", "recall", "f1", "mean_iou", "mean_confidence", "mean_confidence_tp", "mean_confidence_fp")


@dataclass(frozen=True, eq=False, slots=True)
class Outcomes:
    """What became of detections and labels at a threshold of confidence.

    Parameters
    ----------
    true
        (d,) detections that have found a label.
    false
        (d,) those that have found none.
    found, missed
        (g,) labels; a crowd is neither.
    """

    true: Bool[np.ndarray, " d"]
    false: Bool[np.ndarray, " d"]
    found: Bool[np.ndarray, " g"]
    missed: Bool[np.ndarray, " g"]


def outcomes(labels: Labels, predictions: Predictions, matching: Matching, threshold: float) -> Outcomes:
    """True and false detections, found and missed labels, where only scores of at least `threshold` count."""
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
    labels: Labels,
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
    labels, predictions, matching, seen
        What was found.
    of_detection, of_label
        (d,), (g,) the group that each belongs to; those of a negative group count nowhere.
    groups
        How many there are.
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
    """`FIGURES` from `SUMS` in the last axis; nan where nothing defines one.

    Examples
    --------
    The paper's Figure 9, real images alone, in percent:

    >>> import numpy as np
    >>> found = figures(np.array([688.0, 49, 391, 0, 0, 0]))
    >>> [round(100 * float(found[key]), 1) for key in ("precision", "recall", "f1")]
    [93.4, 63.8, 75.8]
    """
    tp, fp, fn, iou, sure_tp, sure_fp = np.moveaxis(np.asarray(sums, dtype=np.float64), -1, 0)
    return {
        "precision": ratio(tp, tp + fp),
        "recall": ratio(tp, tp + fn),
        "f1": ratio(2.0 * tp, 2.0 * tp + fp + fn),
        "mean_iou": ratio(iou, tp),
        "mean_confidence": ratio(sure_tp + sure_fp, tp + fp),
        "mean_confidence_tp": ratio(sure_tp, tp),
        "mean_confidence_fp": ratio(sure_fp, fp),
    }


def ratio(part: ArrayLike, whole: ArrayLike) -> Float[np.ndarray, "..."]:
    """`part / whole`, nan where the whole is 0."""
    part, whole = np.asarray(part, dtype=np.float64), np.asarray(whole, dtype=np.float64)
    return np.divide(part, whole, out=np.full(np.broadcast(part, whole).shape, np.nan), where=whole != 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Curves:
    """Precision, recall and F1 over k thresholds of confidence, which are the scores that occur, falling.

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
        """The threshold of the highest F1, the highest such; None if there is nothing to choose from."""
        if not len(self.f1) or np.isnan(self.f1).all():
            return None
        return float(self.threshold[int(np.nanargmax(self.f1))])


def curves(labels: Labels, predictions: Predictions, matching: Matching, *, label: int | None = None) -> Curves:
    """How the figures go with the threshold, of one class or of all."""
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
    labels: Labels, predictions: Predictions, pairs: Pairs, matching: Matching, seen: Outcomes
) -> Int[np.ndarray, "k k"]:
    """What was taken for what: rows are true classes, columns detected ones, the last of each is the background.

    The diagonal is the true detections. What they leave is matched again, whatever its class, by the same rule; what
    is left then is background.
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
