"""Causes of errors: each false positive and each miss gets one cause, and each cause its loss of AP.

References
----------
Bolya, Foley, Hays and Hoffman, TIDE: A General Toolbox for Identifying Object Detection Errors, ECCV 2020, section 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from hulldown.training.evaluation.average_precision import weighted_averages
from hulldown.training.evaluation.matching import Matching, Overlaps

BACKGROUND = 0.1  # IoU below which a detection means no label
CAUSES = ("class", "localization", "both", "duplicate", "background", "missed")
NONE = -1


@dataclass(frozen=True, eq=False, slots=True)
class Errors:
    """The cause of every error."""

    cause: Int[np.ndarray, " d"]  # index into `CAUSES` of each detection; -1 if it's true or ignored
    meant: Int[np.ndarray, " d"]  # the label meant by a detection of the wrong class or place; -1 if none
    loss: dict[str, float]  # for each of `CAUSES` the AP50 that fixing it alone would gain; nan without labels


def errors(matching: Matching) -> Errors:
    """Classify the errors of all detections of any score.

    `matching` is at the foreground threshold, an IoU of 0.5 in the paper, and has all pairs with an IoU of at least
    `BACKGROUND`.
    """
    cause, meant = _causes(matching)
    return Errors(cause, meant, _losses(matching, cause, meant))


def _causes(matching: Matching) -> tuple[Int[np.ndarray, " d"], Int[np.ndarray, " d"]]:
    """Cause of each false positive, and the label that it meant, by the order of the paper's program."""
    labels, predictions = matching.labels, matching.predictions
    pairs = matching.pairs.where(~labels.crowd[matching.pairs.box])
    same = predictions.class_index[pairs.detection] == labels.class_index[pairs.box]
    foreground = pairs.iou >= matching.iou_threshold
    place, other, doubled, anything = (
        _best(pairs, among, len(predictions.score))
        for among in (same & ~foreground, ~same & foreground, same & foreground, pairs.iou >= BACKGROUND)
    )
    # The paper's program uses the best overlap with the class, which isn't a localization error in the foreground.
    place = np.where(doubled >= 0, NONE, place)
    asked = [place >= 0, other >= 0, doubled >= 0, anything < 0]
    names = ["localization", "class", "duplicate", "background"]
    cause = np.select(asked, [CAUSES.index(name) for name in names], CAUSES.index("both"))
    cause = np.where(matching.false, cause, NONE)
    meant = np.where(cause == CAUSES.index("localization"), place, NONE)
    return cause, np.where(cause == CAUSES.index("class"), other, meant)


def _best(pairs: Overlaps, among: Bool[np.ndarray, " p"], detections: int) -> Int[np.ndarray, " d"]:
    """(d,) label with the highest overlap of each detection, among some pairs; -1 if none."""
    some = pairs.where(among)
    order = np.lexsort((some.iou, some.detection))
    best = np.full(detections, NONE, dtype=np.int64)
    best[some.detection[order]] = some.box[order]  # the last assignment stays: the highest overlap
    return best


def _losses(matching: Matching, cause: Int[np.ndarray, " d"], meant: Int[np.ndarray, " d"]) -> dict[str, float]:
    labels, predictions = matching.labels, matching.predictions
    wanted = np.bincount(labels.class_index[~labels.crowd], minlength=len(predictions.class_names))
    order = np.argsort(-predictions.score, kind="stable")

    def mean_ap(
        label: Int[np.ndarray, " d"],
        true: Bool[np.ndarray, " d"],
        counted: Bool[np.ndarray, " d"],
        left: Int[np.ndarray, " c"],
    ) -> float:
        """Return mean AP over classes with labels; if none is left in one, it's 1 without false positives, else 0."""
        each = []
        for c in np.flatnonzero(wanted):
            right = true[order][(counted & (label == c))[order]][None]
            once, number = np.ones(right.shape), np.array([float(left[c])])
            each.append(weighted_averages(right, once > 0, once, number)[0, 0] if left[c] > 0 else float(right.all()))
        return float(np.mean(each)) if each else float("nan")

    missed, counted, true = matching.missed, ~matching.ignored, matching.true
    missed[meant[meant >= 0]] = False
    before = mean_ap(predictions.class_index, true, counted, wanted)
    loss = {}
    for number, name in enumerate(CAUSES):
        kept, right, label, left = counted.copy(), true.copy(), predictions.class_index.copy(), wanted
        if name == "missed":
            left = wanted - np.bincount(labels.class_index[missed], minlength=len(wanted))
        else:
            kept[cause == number] = False
        if name in ("class", "localization"):
            # One that means a found label, or the label of a more confident one, would be a duplicate.
            rows = order[cause[order] == number]
            rows = rows[~matching.found[meant[rows]]]
            mended = rows[np.unique(meant[rows], return_index=True)[1]]
            kept[mended], right[mended], label[mended] = True, True, labels.class_index[meant[mended]]
        loss[name] = mean_ap(label, right, kept, left) - before
    return loss
