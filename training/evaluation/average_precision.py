"""Average precision: of a test set by faster-coco-eval, and of resampled test sets by array operations.

faster-coco-eval equals pycocotools on thousands of random sets with crowds, ties, areas, and empty classes, in a sixth
of its time. No library resamples positions, or knows oriented boxes; both need the match of every detection,
from `training.evaluation.matching`.

References
----------
Lin et al., Microsoft COCO, ECCV 2014; the COCO evaluation code, `COCOeval.accumulate`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from faster_coco_eval import COCO, COCOeval_faster
from jaxtyping import Bool, Float

from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.matching import Matching
from hulldown.training.evaluation.metrics import ratio
from hulldown.training.evaluation.predictions import Predictions

RECALLS = np.linspace(0.0, 1.0, 101)
IOUS = tuple(np.linspace(0.5, 0.95, 10).tolist())  # IoUs of AP, bit-equal to COCO's
AT_50, AT_75 = 0, 5  # indices of AP50's and AP75's
CELLS = 1 << 22  # approximate largest size of an array
KEYS = ("id", "image_id", "category_id", "bbox", "area", "iscrowd", "score")  # of a COCO annotation
AVERAGES = ("ap", "ap50", "ap75")
SUMMARY = (
    *("ap", "ap50", "ap75", "ap_small", "ap_medium", "ap_large"),
    *("ar_1", "ar_10", "ar_100", "ar_small", "ar_medium", "ar_large"),
)


def average_precision(labels: Labels, predictions: Predictions) -> dict[str, float]:
    """AP and AR over all classes as COCO defines them: the twelve figures of its summary; nan where COCO has -1."""
    if not len(predictions.score):
        # The library refuses an empty list of results. Without detections, AP is 0 if there are labels.
        return dict.fromkeys(SUMMARY, float("nan") if labels.crowd.all() else 0.0)
    evaluation = COCOeval_faster(*_loaded(labels, predictions), "bbox", print_function=lambda *text: None)
    evaluation.evaluate()
    evaluation.accumulate()
    evaluation.summarize()
    figures = (float(figure) if figure >= 0 else float("nan") for figure in evaluation.stats)
    return dict(zip(SUMMARY, figures, strict=False))


def _loaded(labels: Labels, predictions: Predictions) -> list[COCO]:
    """Labels and detections for the library; images, classes, and boxes are numbered from 1."""
    areas, nothing = predictions.xywh[:, 2] * predictions.xywh[:, 3], np.zeros(len(predictions.score), dtype=bool)
    loaded = []
    for boxes, area, crowd, score in (
        (labels, labels.area, labels.crowd, np.zeros(len(labels.area))),  # a label's score is ignored
        (predictions, areas, nothing, predictions.score),
    ):
        columns = (boxes.image + 1, boxes.class_index + 1, boxes.xywh, area, crowd.astype(np.int64), score)
        rows = enumerate(zip(*(column.tolist() for column in columns), strict=True), start=1)
        coco = COCO()
        coco.dataset = {
            "images": [{"id": i + 1} for i in range(len(labels.images))],
            "categories": [{"id": c + 1} for c in range(len(predictions.class_names))],
            "annotations": [dict(zip(KEYS, (k, *row), strict=True)) for k, row in rows],
        }
        coco.createIndex()
        loaded.append(coco)
    return loaded


def resampled_averages(
    matchings: Sequence[Matching], weights: Float[np.ndarray, "r positions"]
) -> Float[np.ndarray, "r c 3"]:
    """`AVERAGES` of each class in each resample of positions; nan if a resample has no label of the class."""
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
        at_once = max(1, CELLS // max(1, len(rows)))
        parts = np.split(weights, range(at_once, len(weights), at_once))
        found = np.concatenate([weighted_averages(true, counts, some[:, where], some @ wanted_at) for some in parts])
        each.append(np.stack([found.mean(axis=1), found[:, AT_50], found[:, AT_75]], axis=1))
    return np.stack(each, axis=1) if each else np.zeros((len(weights), 0, len(AVERAGES)))


def weighted_averages(
    true: Bool[np.ndarray, "i d"],
    counts: Bool[np.ndarray, "i d"],
    weight: Float[np.ndarray, "r d"],
    labels: Float[np.ndarray, " r"],
) -> Float[np.ndarray, "r i"]:
    """AP of one class with integer weights of detections: COCO's mean precision at 101 recalls.

    Precision has its maxima at true detections, so only those are searched.

    `labels`: number of labels; without any the result is nan.
    """
    # The least count of found labels that reaches each recall, with the rounding of a division.
    least = np.ceil(RECALLS * labels[:, None])
    with np.errstate(invalid="ignore", divide="ignore"):
        least -= (least > 0) & ((least - 1) / labels[:, None] >= RECALLS)
        least += least / labels[:, None] < RECALLS
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


def class_mean(each: Float[np.ndarray, "r c *more"]) -> Float[np.ndarray, "r *more"]:
    """Return the mean over classes with labels, as in COCO; nan without any."""
    return ratio(np.nansum(each, axis=1), (~np.isnan(each)).sum(axis=1))
