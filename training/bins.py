"""Where a detector fails: what it found in bins of what is known about labels, and the worst of these in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from training.bootstrap import wilson
from training.fields import Field
from training.labels import Labels
from training.matching import Matching
from training.metrics import Outcomes, ratio
from training.predictions import Predictions

ENOUGH = 10  # labels in a bin before it is called one of the worst


@dataclass(frozen=True, eq=False, slots=True)
class BinFigures:
    """What was found in the b bins of a field.

    Parameters
    ----------
    field
        The field.
    labels, found
        (b,) how many there are, and how many were found.
    recall, recall_interval
        (b,), (2, b) with Wilson's interval of 95 %.
    precision, precision_interval
        The same of the detections in a bin; nan where that is not defined.
    detections
        (b,) how many there are above the threshold; -1 where that is not defined.
    mean_iou
        (b,) of the matches.
    """

    field: Field
    labels: Int[np.ndarray, " b"]
    found: Int[np.ndarray, " b"]
    recall: Float[np.ndarray, " b"]
    recall_interval: Float[np.ndarray, "2 b"]
    detections: Int[np.ndarray, " b"]
    precision: Float[np.ndarray, " b"]
    precision_interval: Float[np.ndarray, "2 b"]
    mean_iou: Float[np.ndarray, " b"]


def figures_of(
    field: Field, labels: Labels, predictions: Predictions, matching: Matching, seen: Outcomes
) -> BinFigures:
    """Recall, precision where it is defined, and mean IoU in every bin."""
    n = len(field.bins)

    def count(group: np.ndarray, among: np.ndarray) -> np.ndarray:
        return np.bincount(group[among & (group >= 0)], minlength=n)

    there, found = count(field.of_label, ~labels.crowd), count(field.of_label, seen.found)
    overlap = np.zeros(len(labels.label))
    overlap[seen.found] = matching.iou[matching.detection[seen.found]]
    known = field.of_label >= 0
    total = np.bincount(field.of_label[known], weights=overlap[known], minlength=n)
    if field.of_detection is None:
        detections, precision, ends = np.full(n, -1), np.full(n, np.nan), np.full((2, n), np.nan)
    else:
        detections = count(field.of_detection, seen.true | seen.false)
        true = count(field.of_detection, seen.true)
        precision, ends = ratio(true, detections), wilson(true.astype(np.float64), detections.astype(np.float64))
    return BinFigures(
        field=field,
        labels=there,
        found=found,
        recall=ratio(found, there),
        recall_interval=wilson(found.astype(np.float64), there.astype(np.float64)),
        detections=detections,
        precision=precision,
        precision_interval=ends,
        mean_iou=ratio(total, found),
    )


def worst(found: Sequence[BinFigures], *, count: int = 3, enough: int = ENOUGH) -> list[str]:
    """The bins of the lowest recall, in words: those whose interval ends lowest, one a field.

    Bins of fewer labels than `enough`, and those whose recall is not below that of all, are not among them.
    """
    rows = []
    for one in found:
        total = float(ratio(one.found.sum(), one.labels.sum()))
        for b in np.flatnonzero((one.labels >= enough) & (one.recall < total)):
            low, high = one.recall_interval[:, b]
            words = (
                f"{one.field.title} {one.field.bins[b]}: {one.found[b]} of {one.labels[b]} found, recall "
                f"{one.recall[b]:.2f} ({low:.2f} to {high:.2f}), against {total:.2f} of all"
            )
            rows.append((float(high), float(low), one.field.name, words))
    picked: dict[str, str] = {}
    for _, _, name, words in sorted(rows):
        picked.setdefault(name, words)
    return list(picked.values())[:count]
