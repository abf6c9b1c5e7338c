"""Where a detector fails: what it found in bins of what is known about labels, and the worst of these in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from training.bootstrap import ratio_error, share_interval
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
        (b,), (2, b) with the 95 % interval; nan with too few positions to tell.
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
    field: Field, labels: Labels, predictions: Predictions, matching: Matching, seen: Outcomes, *,
    position: Int[np.ndarray, " n"],
) -> BinFigures:  # fmt: skip
    """Recall, precision where it is defined, and mean IoU in every bin; `position` is that of each image."""
    n = len(field.bins)
    positions = int(position.max()) + 1 if len(position) else 0

    def count(group: np.ndarray, image: np.ndarray, among: np.ndarray) -> Float[np.ndarray, "positions b"]:
        kept = among & (group >= 0)
        cell = position[image[kept]] * n + group[kept]
        return np.bincount(cell, minlength=positions * n).reshape(positions, n).astype(np.float64)

    there = count(field.of_label, labels.image, ~labels.crowd)
    found = count(field.of_label, labels.image, seen.found)
    overlap = np.zeros(len(labels.label))
    overlap[seen.found] = matching.iou[matching.detection[seen.found]]
    known = field.of_label >= 0
    total = np.bincount(field.of_label[known], weights=overlap[known], minlength=n)
    if field.of_detection is None:
        detections, precision, ends = np.full(n, -1), np.full(n, np.nan), np.full((2, n), np.nan)
    else:
        counted = count(field.of_detection, predictions.image, seen.true | seen.false)
        true = count(field.of_detection, predictions.image, seen.true)
        detections = counted.sum(axis=0).astype(np.int64)
        precision, ends = _share(true, counted)
    recall, recall_ends = _share(found, there)
    return BinFigures(
        field=field,
        labels=there.sum(axis=0).astype(np.int64),
        found=found.sum(axis=0).astype(np.int64),
        recall=recall,
        recall_interval=recall_ends,
        detections=detections,
        precision=precision,
        precision_interval=ends,
        mean_iou=ratio(total, found.sum(axis=0)),
    )


def _share(
    part: Float[np.ndarray, "positions b"], whole: Float[np.ndarray, "positions b"]
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, "2 b"]]:
    """A ratio of sums over positions, with its interval."""
    value, trials = ratio(part.sum(axis=0), whole.sum(axis=0)), whole.sum(axis=0)
    return value, share_interval(value, ratio_error(part, whole), freedom=(whole > 0).sum(axis=0) - 1, trials=trials)


def worst(found: Sequence[BinFigures], *, count: int = 3, enough: int = ENOUGH) -> list[str]:
    """The bins of the lowest recall, in words: those whose interval ends lowest, one a field.

    Bins of fewer labels than `enough`, and those whose recall is not below that of all, are not among them.
    """
    rows = []
    for one in found:
        total = float(ratio(one.found.sum(), one.labels.sum()))
        told = (one.labels >= enough) & (one.recall < total) & ~np.isnan(one.recall_interval[0])
        for b in np.flatnonzero(told):
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
