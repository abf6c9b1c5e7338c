"""Average precision: by pycocotools itself, and at one IoU on arrays, for what asks often."""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from training.labels import Labels
from training.matching import MAX_DETECTIONS
from training.predictions import Predictions

RECALLS = np.linspace(0.0, 1.0, 101)
SUMMARY = (
    *("ap", "ap50", "ap75", "ap_small", "ap_medium", "ap_large"),
    *("ar_1", "ar_10", "ar_100", "ar_small", "ar_medium", "ar_large"),
)


@dataclass(frozen=True, eq=False, slots=True)
class AveragePrecision:
    """What pycocotools says.

    Parameters
    ----------
    summary
        The twelve figures of its summary, by name; nan where it says -1.
    ap, ap50, ap75
        (c,) of each class; nan for a class without labels.
    """

    summary: dict[str, float]
    ap: Float[np.ndarray, " c"]
    ap50: Float[np.ndarray, " c"]
    ap75: Float[np.ndarray, " c"]


def official(labels: Labels, predictions: Predictions) -> AveragePrecision:
    """AP and AR of all classes, computed by pycocotools."""
    classes = len(predictions.class_names)
    if not len(predictions.score):
        # pycocotools takes no empty list of results. Nothing was found: 0 where there is something to find.
        known = np.bincount(labels.label[~labels.crowd], minlength=classes) > 0
        each = np.where(known, 0.0, np.nan)
        return AveragePrecision(dict.fromkeys(SUMMARY, 0.0 if known.any() else float("nan")), each, each, each)
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation = COCOeval(*_loaded(labels, predictions), "bbox")
        evaluation.params.maxDets = [1, 10, MAX_DETECTIONS]
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    # (IoU, recall, class, area, detections): all areas, the most detections.
    precision = np.where(evaluation.eval["precision"] < 0, np.nan, evaluation.eval["precision"])[:, :, :, 0, -1]
    each = np.mean(precision, axis=1)
    summary = [float(figure) if figure >= 0 else float("nan") for figure in evaluation.stats]
    return AveragePrecision(dict(zip(SUMMARY, summary, strict=True)), each.mean(axis=0), each[0], each[5])


def _loaded(labels: Labels, predictions: Predictions) -> tuple[COCO, COCO]:
    """Truth and results as pycocotools takes them, with ids from 1: it takes annotation 0 for unmatched."""
    head: dict[str, Any] = {
        "images": [{"id": i} for i in range(len(labels.image_id))],
        "categories": [{"id": i} for i in predictions.class_id.tolist()],
    }
    true = _records(labels, predictions)
    for record, area, crowd in zip(true, labels.area.tolist(), labels.crowd.tolist(), strict=True):
        record |= {"area": area, "iscrowd": int(crowd)}
    found = _records(predictions, predictions)
    areas = (predictions.xywh[:, 2] * predictions.xywh[:, 3]).tolist()
    for record, area, score in zip(found, areas, predictions.score.tolist(), strict=True):
        record |= {"area": area, "iscrowd": 0, "score": score}
    loaded = COCO(), COCO()
    for coco, records in zip(loaded, (true, found), strict=True):
        coco.dataset = {**head, "annotations": records}
        coco.createIndex()
    return loaded


def _records(boxes: Labels | Predictions, predictions: Predictions) -> list[dict[str, Any]]:
    columns = (boxes.image.tolist(), predictions.class_id[boxes.label].tolist(), boxes.xywh.tolist())
    # Numbered by place: images need not be known by their own ids.
    return [
        {"id": k, "image_id": image, "category_id": category, "bbox": box}
        for k, (image, category, box) in enumerate(zip(*columns, strict=True), start=1)
    ]


def at_one_iou(true: Bool[np.ndarray, " d"], labels: float, *, weight: Float[np.ndarray, " d"] | None = None) -> float:
    """AP of one class as COCO has it: precision at 101 recalls, none lower than at a higher recall.

    Parameters
    ----------
    true
        (d,) whether each detection has found a label, by falling score.
    labels
        How many there are to find.
    weight
        (d,) how often each detection counts; None: once.

    Returns
    -------
    nan if there is nothing to find.
    """
    if labels <= 0:
        return float("nan")
    counts = np.ones(len(true)) if weight is None else weight
    tp, fp = np.cumsum(counts * true), np.cumsum(counts * ~true)
    recall, precision = tp / labels, tp / (tp + fp + np.spacing(1))
    highest = np.maximum.accumulate(precision[::-1])[::-1]
    at = np.searchsorted(recall, RECALLS, side="left")
    return float(np.concatenate([highest, [0.0]])[np.minimum(at, len(highest))].mean())
