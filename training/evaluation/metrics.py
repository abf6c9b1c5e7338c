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

from hulldown.training.evaluation.matching import Matching, greedy

SUMS = ("tp", "fp", "fn", "iou", "confidence_tp", "confidence_fp")  # quantities that add up over images
FIGURES = ("precision", "recall", "f1", "mean_iou", "mean_confidence", "mean_confidence_tp", "mean_confidence_fp")
SHARES = ("precision", "recall", "f1")  # figures that are ratios of counts; the others are means


@dataclass(frozen=True, eq=False, slots=True)
class Outcomes:
    """Outcomes of detections and labels at a confidence threshold.

    Parameters
    ----------
    matching
        Their matches.
    true
        (d,) true positives.
    false
        (d,) false positives.
    found, missed
        (g,) found and missed labels; a crowd is neither.
    """

    matching: Matching
    true: Bool[np.ndarray, " d"]
    false: Bool[np.ndarray, " d"]
    found: Bool[np.ndarray, " g"]
    missed: Bool[np.ndarray, " g"]


def outcomes(matching: Matching, threshold: float) -> Outcomes:
    """Outcomes of detections with scores of at least `threshold`."""
    counted = (matching.predictions.score >= threshold) & ~matching.ignored
    found = np.zeros(len(matching.detection), dtype=bool)
    matched = matching.detection >= 0
    found[matched] = counted[matching.detection[matched]]
    return Outcomes(
        matching,
        true=counted & (matching.box >= 0),
        false=counted & (matching.box < 0),
        found=found,
        missed=~found & ~matching.labels.crowd,
    )


def sums_by(
    seen: Outcomes, *, of_detection: Int[np.ndarray, " d"], of_label: Int[np.ndarray, " g"], bins: int
) -> Float[np.ndarray, "positions bins 6"]:
    """`SUMS` of each bin in each position.

    Parameters
    ----------
    seen
        The outcomes.
    of_detection, of_label
        (d,), (g,) bin of each; negative ones are ignored.
    bins
        Number of bins.
    """
    matching = seen.matching
    labels, predictions = matching.labels, matching.predictions

    def totals(of: np.ndarray, image: np.ndarray, *weights: np.ndarray) -> list[np.ndarray]:
        inside = of >= 0
        cell = labels.position[image[inside]] * bins + of[inside]
        return [np.bincount(cell, weights=weight[inside], minlength=labels.positions * bins) for weight in weights]

    means = ((seen.true, matching.iou), (seen.true, predictions.score), (seen.false, predictions.score))
    weights = (np.where(counted, value, 0.0) for counted, value in means)
    tp, fp, *rest = totals(of_detection, predictions.image, seen.true, seen.false, *weights)
    fn = totals(of_label, labels.image, seen.missed)
    return np.stack([tp, fp, *fn, *rest], axis=1, dtype=np.float64).reshape(labels.positions, bins, len(SUMS))


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
    each = map(np.asarray, (tp + fp, tp + fn, 2.0 * tp + fp + fn, tp, tp + fp, tp, fp))
    return dict(zip(FIGURES, each, strict=True))


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
        return float(self.threshold[np.argmax(self.f1)]) if len(self.f1) else None


def curves(matching: Matching, *, label: int | None = None) -> Curves:
    """Curves over the threshold, of one class or of all."""
    labels, predictions = matching.labels, matching.predictions
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


def confusion(seen: Outcomes) -> Int[np.ndarray, "k k"]:
    """The confusion matrix: rows are true classes, columns detected ones, the last of each is the background.

    The diagonal has the true positives. The rest is matched again, ignoring classes, by the same rule; what
    remains is background.
    """
    matching = seen.matching
    labels, predictions, pairs = matching.labels, matching.predictions, matching.pairs
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


def sums_at_best(matching: Matching, weights: Float[np.ndarray, "r positions"]) -> Float[np.ndarray, "r c 6"]:
    """`SUMS` of each class in each resample of positions, at the threshold of the best F1 in that resample.

    `weights` are the count of each position in each resample.
    """
    labels, predictions = matching.labels, matching.predictions
    classes = len(predictions.class_names)
    rows = np.flatnonzero(~matching.ignored)
    rows = rows[np.argsort(-predictions.score[rows], kind="stable")]
    score, label, true = predictions.score[rows], predictions.label[rows], matching.box[rows] >= 0
    last = np.flatnonzero(np.append(score[1:] != score[:-1], True)[: len(rows)])  # of each threshold
    iou, where = np.where(true, matching.iou[rows], 0.0), labels.position[predictions.image[rows]]
    wanted = np.flatnonzero(~labels.crowd)
    result = np.zeros((len(weights), classes, len(SUMS)))
    for k, weight in enumerate(weights):
        counts = weight[labels.position[labels.image[wanted]]]
        per_class = np.bincount(labels.label[wanted], weights=counts, minlength=classes)
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
