"""Average precision: of a test set by faster-coco-eval, and of resampled test sets by array operations.

faster-coco-eval equals pycocotools on thousands of random sets with crowds, ties, areas, and empty classes, in a sixth
of its time. No library resamples positions.

Lin et al., Microsoft COCO, ECCV 2014; the COCO evaluation code, `COCOeval.accumulate`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.matching import Matching, load_coco_evaluation
from hulldown.training.evaluation.metrics import ratio_or_nan
from hulldown.training.evaluation.predictions import Predictions

RECALL_GRID = np.linspace(0.0, 1.0, 101)
IOU_THRESHOLDS = tuple(np.linspace(0.5, 0.95, 10).tolist())  # of AP, bit-equal to COCO's
AT_50, AT_75 = 0, 5  # indices of AP50's and AP75's
MAX_ARRAY_CELLS = 1 << 22  # approximate
AP_NAMES = ("ap", "ap50", "ap75")
AP_SUMMARY = (
    *("ap", "ap50", "ap75", "ap_small", "ap_medium", "ap_large"),
    *("ar_1", "ar_10", "ar_100", "ar_small", "ar_medium", "ar_large"),
)


def coco_summary(labels: Labels, predictions: Predictions) -> dict[str, float]:
    """Return the twelve figures of COCO's summary over all classes; nan where COCO has -1."""
    return coco_summary_and_class_aps(labels, predictions)[0]


def coco_summary_and_class_aps(labels: Labels, predictions: Predictions) -> tuple[dict[str, float], Float[np.ndarray, "c 3"]]:
    """Return COCO's summary over all classes, and `AP_NAMES` of each class; nan without labels."""
    if not len(predictions.score):
        # The library refuses an empty list of results. Without detections, AP is 0 if there are labels.
        wanted = np.bincount(labels.class_index[~labels.crowd], minlength=len(predictions.class_names)) > 0
        each = np.where(wanted, 0.0, np.nan)
        return dict.fromkeys(AP_SUMMARY, 0.0 if wanted.any() else np.nan), np.tile(each[:, None], len(AP_NAMES))
    evaluation = load_coco_evaluation(labels, predictions)
    evaluation.run()
    figures = (float(figure) if figure >= 0 else float("nan") for figure in evaluation.stats)
    found = evaluation.eval["precision"][:, :, :, 0, -1].mean(axis=1)  # of each IoU and class, over recalls
    each = np.stack([found.mean(axis=0), found[AT_50], found[AT_75]], axis=1)
    return dict(zip(AP_SUMMARY, figures, strict=False)), np.where(each < 0.0, np.nan, each)


def resampled_class_aps(matchings: Sequence[Matching], weights: Float[np.ndarray, "r positions"]) -> Float[np.ndarray, "r c 3"]:
    """Return `AP_NAMES` of each class in each resample of positions; nan if a resample has no label of it."""
    labels, predictions = matchings[0].labels, matchings[0].predictions
    order = np.argsort(-predictions.score, kind="stable")
    each = []
    for c in range(len(predictions.class_names)):
        rows = order[predictions.class_index[order] == c]
        where = labels.position[predictions.image[rows]]
        wanted = labels.position[labels.image[(labels.class_index == c) & ~labels.crowd]]
        wanted_at = np.bincount(wanted, minlength=weights.shape[1]).astype(np.float64)
        counts = np.stack([~one.ignored[rows] for one in matchings])
        true = np.stack([one.true[rows] for one in matchings])
        at_once = max(1, MAX_ARRAY_CELLS // max(1, len(rows)))
        parts = np.split(weights, range(at_once, len(weights), at_once))
        found = np.concatenate([weighted_class_ap(true, counts, some[:, where], some @ wanted_at) for some in parts])
        each.append(np.stack([found.mean(axis=1), found[:, AT_50], found[:, AT_75]], axis=1))
    return np.stack(each, axis=1) if each else np.zeros((len(weights), 0, len(AP_NAMES)))


def weighted_class_ap(
    true: Bool[np.ndarray, "i d"],
    counts: Bool[np.ndarray, "i d"],
    weight: Float[np.ndarray, "r d"],
    labels: Float[np.ndarray, " r"],
) -> Float[np.ndarray, "r i"]:
    """Return COCO's AP of one class with integer weights of detections, at 101 recalls; nan for no `labels`."""
    # The least count of found labels that reaches each recall, with the rounding of a division.
    least = np.ceil(RECALL_GRID * labels[:, None])
    with np.errstate(invalid="ignore", divide="ignore"):
        least -= (least > 0) & ((least - 1) / labels[:, None] >= RECALL_GRID)
        least += least / labels[:, None] < RECALL_GRID
    result = np.empty((len(weight), len(true)))
    for k, right in enumerate(true):
        if k == 0 or (counts[k] != counts[k - 1]).any():
            all_so_far = np.cumsum(weight * counts[k], axis=1)
        columns = np.flatnonzero(right)
        tp = np.cumsum(weight[:, columns], axis=1)
        precision = tp / (all_so_far[:, columns] + np.spacing(1))
        highest = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        # One search for all resamples, each in its own range of counts.
        apart = (labels.max(initial=0.0) + 2.0) * np.arange(len(weight))[:, None]
        at = np.searchsorted((tp + apart).ravel(), (least + apart).ravel()).reshape(least.shape)
        at -= len(columns) * np.arange(len(weight))[:, None]
        padded = np.concatenate([highest, np.zeros((len(weight), 1))], axis=1)
        result[:, k] = np.take_along_axis(padded, np.minimum(at, len(columns)), axis=1).mean(axis=1)
    return np.where(labels[:, None] > 0, result, np.nan)


def mean_over_classes(each: Float[np.ndarray, "r c *more"]) -> Float[np.ndarray, "r *more"]:
    """Return the mean over classes with labels, as in COCO; nan without any."""
    return ratio_or_nan(np.nansum(each, axis=1), (~np.isnan(each)).sum(axis=1))
