"""The paper's figures at an operating point: counts, precision, recall, F1, mean IoU, mean confidence; and curves.

References
----------
Paper, section 2.3.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from hulldown.training.evaluation.matching import Matching, greedy
from hulldown.training.evaluation.predictions import places

COUNTS = ("tp", "fp", "fn")
SUMS = (*COUNTS, "iou", "confidence_tp", "confidence_fp")  # quantities that add up over images
SHARES = ("precision", "recall", "f1")  # ratios of counts
MEANS = ("mean_iou", "mean_confidence", "mean_confidence_tp", "mean_confidence_fp")
FIGURES = (*SHARES, *MEANS)


def sums_by(
    matching: Matching, *, of_detection: Int[np.ndarray, " d"], of_label: Int[np.ndarray, " g"], bins: int
) -> Float[np.ndarray, "positions bins 6"]:
    """Return `SUMS` of each bin in each position."""
    labels, predictions, true, false = matching.labels, matching.predictions, matching.true, matching.false

    def totals(of: np.ndarray, image: np.ndarray, *weights: np.ndarray) -> list[np.ndarray]:
        inside = of >= 0
        cell = labels.position[image[inside]] * bins + of[inside]
        return [np.bincount(cell, weights=weight[inside], minlength=labels.positions * bins) for weight in weights]

    means = ((true, matching.iou), (true, predictions.score), (false, predictions.score))
    weights = (np.where(counted, value, 0.0) for counted, value in means)
    tp, fp, *rest = totals(of_detection, predictions.image, true, false, *weights)
    fn = totals(of_label, labels.image, matching.missed)
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


def curves(matching: Matching, *, label: int | None = None) -> dict[str, Float[np.ndarray, " k"]]:
    """``precision``, ``recall``, and ``f1`` at k values of ``threshold``: all scores, falling; of a class or of all."""
    labels, predictions = matching.labels, matching.predictions
    counted, wanted = ~matching.ignored, ~labels.crowd
    if label is not None:
        counted, wanted = counted & (predictions.class_index == label), wanted & (labels.class_index == label)
    rows, last = _by_score(predictions.score, counted)
    tp = np.cumsum(matching.true[rows])[last]
    fp, fn = last + 1 - tp, int(wanted.sum()) - tp
    return {
        "threshold": predictions.score[rows][last],
        "precision": ratio(tp, tp + fp),
        "recall": ratio(tp, tp + fn),
        "f1": ratio(2 * tp, 2 * tp + fp + fn),
    }


def _by_score(
    score: Float[np.ndarray, " d"], counted: Bool[np.ndarray, " d"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " k"]]:
    """Return counted detections by falling score, and the places of the last one of each score."""
    rows = np.flatnonzero(counted)
    rows = rows[np.argsort(-score[rows], kind="stable")]
    return rows, np.flatnonzero(np.diff(score[rows], append=np.nan) != 0.0)


def confusion(matching: Matching) -> Int[np.ndarray, "k k"]:
    """Return the confusion matrix: rows are true classes, columns detected ones, the last of each is the background.

    The diagonal has the true positives. The rest is matched again, ignoring classes, by the same rule; what
    remains is background.
    """
    labels, predictions, pairs = matching.labels, matching.predictions, matching.pairs
    background = len(predictions.class_names)
    counted, missed = ~matching.ignored, matching.missed
    enough = pairs.iou >= min(matching.iou_threshold, 1.0 - 1e-10)
    left = pairs.where(enough & matching.false[pairs.detection] & missed[pairs.box])
    by_score = np.lexsort((-predictions.score, predictions.image))
    turn = np.empty(len(by_score), dtype=np.int64)
    turn[by_score] = places(predictions.image[by_score])
    mixed = greedy(left, turn, labels.crowd)
    meant = np.where(matching.true, predictions.class_index, background)
    meant[mixed.detection], missed[mixed.box] = labels.class_index[mixed.box], False
    rows = np.concatenate([meant[counted], labels.class_index[missed]])
    columns = np.concatenate([predictions.class_index[counted], np.full(missed.sum(), background)])
    cells = np.bincount(rows * (background + 1) + columns, minlength=(background + 1) ** 2)
    return cells.reshape(background + 1, background + 1)


def sums_at_best(matching: Matching, weights: Float[np.ndarray, "r positions"]) -> Float[np.ndarray, "r c 6"]:
    """Return `SUMS` of each class in each resample of positions, at the threshold of the best F1 in that resample.

    `weights` are the count of each position in each resample.
    """
    labels, predictions = matching.labels, matching.predictions
    classes = len(predictions.class_names)
    rows, last = _by_score(predictions.score, ~matching.ignored)
    score, true, where = predictions.score[rows], matching.true[rows], labels.position[predictions.image[rows]]
    iou = np.where(true, matching.iou[rows], 0.0)
    each = np.stack([true, ~true, np.zeros(len(rows)), iou, true * score, ~true * score], axis=1)
    cells = predictions.class_index[rows], np.arange(len(rows))
    of_class = csr_array((np.ones(len(rows)), cells), (classes, len(rows)))
    of_all = sums_by(matching, of_detection=predictions.class_index, of_label=labels.class_index, bins=classes)
    wanted = weights @ denominators(of_all)["recall"]
    result = np.zeros((len(weights), classes, len(SUMS)))
    for k, weight in enumerate(weights):
        counts = weight[where]
        if len(last):
            f1 = ratio(2.0 * np.cumsum(counts * true)[last], np.cumsum(counts)[last] + wanted[k].sum())
            counts[last[np.argmax(np.nan_to_num(f1))] + 1 :] = 0.0
        result[k] = of_class @ (counts[:, None] * each)
    result[..., 2] = wanted - result[..., 0]
    return result
