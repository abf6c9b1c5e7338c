"""How sure average precision is: AP, AP50 and AP75 of every drawing of a test set's positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from training.average_precision import RECALLS
from training.bootstrap import DRAWN_AT_ONCE, RESAMPLES, resamples
from training.labels import Labels
from training.matching import Matching
from training.predictions import Predictions

IOUS = tuple(np.linspace(0.5, 0.95, 10).tolist())  # of AP, to the bit as pycocotools has them
AT_50, AT_75 = 0, 5  # which of them AP50 and AP75 are at
AVERAGES = ("ap", "ap50", "ap75")


def resampled_averages(
    labels: Labels,
    predictions: Predictions,
    matchings: Sequence[Matching],
    position: Int[np.ndarray, " n"],
    *,
    times: int = RESAMPLES,
    seed: int = 0,
) -> Float[np.ndarray, "r c 3"]:
    """`AVERAGES` of each class in each drawing of positions, as pycocotools has them; nan where it has no labels.

    Parameters
    ----------
    labels, predictions
        Of one dataset.
    matchings
        One for each of `IOUS`.
    position
        (n,) of each image, numbered from 0; drawn together.
    times, seed
        As of `training.bootstrap.resamples`: the same drawings.
    """
    positions = int(position.max()) + 1 if len(position) else 0
    if not positions:
        return np.full((times, len(predictions.class_names), len(AVERAGES)), np.nan)
    return np.concatenate(
        [
            drawn_averages(labels, predictions, matchings, position, weights)
            for weights in resamples(positions, times=times, seed=seed)
        ]
    )


def drawn_averages(
    labels: Labels,
    predictions: Predictions,
    matchings: Sequence[Matching],
    position: Int[np.ndarray, " n"],
    weights: Float[np.ndarray, "r positions"],
) -> Float[np.ndarray, "r c 3"]:
    """The same where `weights` says how often each position was drawn."""
    order = np.argsort(-predictions.score, kind="stable")
    each = []
    for c in range(len(predictions.class_names)):
        mine = order[predictions.label[order] == c]
        where = position[predictions.image[mine]]
        wanted = position[labels.image[(labels.label == c) & ~labels.crowd]]
        wanted_at = np.bincount(wanted, minlength=weights.shape[1]).astype(np.float64)
        counts = np.stack([~one.ignored[mine] for one in matchings])
        true = np.stack([one.box[mine] >= 0 for one in matchings]) & counts
        rows = max(1, DRAWN_AT_ONCE // max(1, len(mine)))
        parts = np.split(weights, range(rows, len(weights), rows))
        found = np.concatenate([weighted_averages(true, counts, some[:, where], some @ wanted_at) for some in parts])
        each.append(np.stack([found.mean(axis=1), found[:, AT_50], found[:, AT_75]], axis=1))
    return np.stack(each, axis=1) if each else np.zeros((len(weights), 0, len(AVERAGES)))


def weighted_averages(
    true: Bool[np.ndarray, "i d"],
    counts: Bool[np.ndarray, "i d"],
    weight: Float[np.ndarray, "r d"],
    labels: Float[np.ndarray, " r"],
) -> Float[np.ndarray, "r i"]:
    """AP of one class where each detection counts some whole number of times, as `at_one_iou` has it.

    Precision is highest where a label has just been found, so what lies between two true detections is added up once
    and not looked at again.

    Parameters
    ----------
    true, counts
        At each of i IoUs, of the detections by falling score, which have found a label and which count at all.
    weight
        How often each was drawn, in each of r drawings.
    labels
        How many there are to find; where there are none the result is nan.
    """
    # The least count of found labels that reaches each recall, to the bit as a division would say.
    least = np.ceil(RECALLS * labels[:, None])
    with np.errstate(invalid="ignore", divide="ignore"):
        least -= (least > 0) & ((least - 1) / labels[:, None] >= RECALLS)
        least += least / labels[:, None] < RECALLS
    result = np.empty((len(weight), len(true)))
    for k, mine in enumerate(true):
        if k == 0 or (counts[k] != counts[k - 1]).any():
            all_so_far = np.cumsum(weight * counts[k], axis=1)
        columns = np.flatnonzero(mine)
        tp = np.cumsum(weight[:, columns], axis=1)
        precision = tp / (all_so_far[:, columns] + np.spacing(1))
        highest = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        # One search for all drawings: each has a range of counts of its own.
        apart = (labels.max(initial=0.0) + 2.0) * np.arange(len(weight))[:, None]
        at = np.searchsorted((tp + apart).ravel(), (least + apart).ravel()).reshape(least.shape)
        at -= len(columns) * np.arange(len(weight))[:, None]
        padded = np.concatenate([highest, np.zeros((len(weight), 1))], axis=1)
        result[:, k] = np.take_along_axis(padded, np.minimum(at, len(columns)), axis=1).mean(axis=1)
    return np.where(labels[:, None] > 0, result, np.nan)
