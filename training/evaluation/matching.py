"""COCO's matching of detections with labels, by faster-coco-eval, which decides exactly as pycocotools does.

The library doesn't know oriented boxes; their overlaps come from Shapely.

Lin et al., Microsoft COCO, ECCV 2014; pycocotools 2.0, `COCOeval.evaluateImg`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from faster_coco_eval import COCO, COCOeval_faster
from jaxtyping import Bool, Float, Int

from hulldown.annotate.labels.oriented_box import visible_rectangle_corners
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.predictions import Predictions

MAX_DETECTIONS = 100  # of a class in an image, COCO's limit
COCO_ANNOTATION_KEYS = ("id", "image_id", "category_id", "bbox", "area", "iscrowd", "score")
ALL_AREAS = [[0.0, 1e10]]  # COCO's range without a limit


@dataclass(frozen=True, eq=False, slots=True)
class Matching:
    """Matches of d detections and g labels, and the outcome of each."""

    labels: Labels
    predictions: Predictions
    iou_threshold: float  # least IoU of a match
    box: Int[np.ndarray, " d"]  # matched label; -1 if none
    iou: Float[np.ndarray, " d"]  # its IoU; nan if none
    # whether the detection is ignored: it's in a crowd, beyond the first hundred, or below a threshold
    ignored: Bool[np.ndarray, " d"]
    detection: Int[np.ndarray, " g"]  # matched detection; -1 if none, and for crowds

    @property
    def true(self) -> Bool[np.ndarray, " d"]:
        """True positives."""
        return (self.box >= 0) & ~self.ignored

    @property
    def false(self) -> Bool[np.ndarray, " d"]:
        """False positives."""
        return (self.box < 0) & ~self.ignored

    @property
    def found(self) -> Bool[np.ndarray, " g"]:
        """Labels with a detection."""
        return self.detection >= 0

    @property
    def missed(self) -> Bool[np.ndarray, " g"]:
        """Labels without a detection; a crowd is neither found nor missed."""
        return (self.detection < 0) & ~self.labels.crowd

    def with_threshold(self, threshold: float) -> Matching:
        """Return the matching without detections below a score, on which other detections' matches don't depend."""
        ignored = self.ignored | (self.predictions.score < threshold)
        detection = self.detection.copy()
        detection[self.box[ignored & (self.box >= 0)]] = -1
        return replace(self, ignored=ignored, detection=detection)


class _OrientedEvaluation(COCOeval_faster):
    """faster-coco-eval's evaluation with overlaps of oriented boxes."""

    def computeIoU(self, imgId: int, catId: int) -> Float[np.ndarray, "d g"] | list[float]:
        """Return overlaps of an image's detections of a class, by falling score, with its labels."""
        sets = self.dt_dataset, self.gt_dataset
        found, true = (one.get_instances([imgId], [catId], True)[0][0] for one in sets)
        found = sorted(found, key=lambda one: -one["score"])[: self.params.maxDets[-1]]
        if not found or not true:
            return []
        first, second = (np.array([one["corners"] for one in boxes]) for boxes in (found, true))
        return oriented_overlaps(first, second, np.array([one["iscrowd"] for one in true], dtype=bool))


def oriented_overlaps(
    found: Float[np.ndarray, "d 4 2"], true: Float[np.ndarray, "g 4 2"], crowd: Bool[np.ndarray, " g"]
) -> Float[np.ndarray, "d g"]:
    """Return IoU of convex quadrilaterals by corners; for crowds, intersection over the detection's area."""
    first, second = shapely.polygons(found)[:, None], shapely.polygons(true)
    shared, own = shapely.area(shapely.intersection(first, second)), shapely.area(first)
    union = np.where(crowd, own, own + shapely.area(second) - shared)
    return np.divide(shared, union, out=np.zeros(shared.shape), where=union > 0.0)


def load_coco_evaluation(labels: Labels, predictions: Predictions) -> COCOeval_faster:
    """Load labels and at least one detection into faster-coco-eval; images, classes, and boxes are numbered from 1."""
    true, found = None, predictions.corners
    areas, never = predictions.xywh[:, 2] * predictions.xywh[:, 3], np.zeros(len(predictions.score), dtype=bool)
    if found is not None:
        images = [labels.images[i] for i in labels.image.tolist()]
        true, areas = list(map(visible_rectangle_corners, labels.annotations, images)), shapely.area(shapely.polygons(found))
    loaded = []
    for boxes, area, crowd, score, corners in (
        (labels, labels.area, labels.crowd, np.zeros(len(labels.area)), true),  # a label's score is ignored
        (predictions, areas, never, predictions.score, found),
    ):
        columns = (boxes.image + 1, boxes.class_index + 1, boxes.xywh, area, crowd.astype(np.int64), score)
        rows = enumerate(zip(*(column.tolist() for column in columns), strict=True), start=1)
        records = [dict(zip(COCO_ANNOTATION_KEYS, (k, *row), strict=True)) for k, row in rows]
        if corners is not None:
            records = [{**one, "corners": turned} for one, turned in zip(records, corners, strict=True)]
        coco = COCO()
        coco.dataset = {
            "images": [{"id": i + 1} for i in range(len(labels.images))],
            "categories": [{"id": c + 1} for c in range(len(predictions.class_names))],
            "annotations": records,
        }
        coco.createIndex()
        loaded.append(coco)
    kind = COCOeval_faster if found is None else _OrientedEvaluation
    return kind(*loaded, "bbox", print_function=lambda *text: None, extra_calc=True)


def match_detections(labels: Labels, predictions: Predictions, *, iou: float = 0.5) -> Matching:
    """Match detections with labels of their class as COCO does."""
    return match_at_each_iou(labels, predictions, [iou])[0]


def match_at_each_iou(labels: Labels, predictions: Predictions, ious: Sequence[float]) -> list[Matching]:
    """Match once for each of several least IoUs."""
    evaluation = load_coco_evaluation(labels, predictions) if len(predictions.score) else None
    return [_match_at_iou(labels, predictions, evaluation, iou) for iou in ious]


def _match_at_iou(labels: Labels, predictions: Predictions, evaluation: COCOeval_faster | None, iou: float) -> Matching:
    box = np.full(len(predictions.score), -1, dtype=np.int64)
    overlap = np.full(len(predictions.score), np.nan)
    detection = np.full(len(labels.class_index), -1, dtype=np.int64)
    ignored = predictions.rank_in_image_class >= MAX_DETECTIONS
    if evaluation is not None:
        wanted = {"iouThrs": np.array([iou]), "areaRng": ALL_AREAS, "areaRngLbl": ["all"], "maxDets": [MAX_DETECTIONS]}
        vars(evaluation.params).update(wanted)
        evaluation.evaluate()
        evaluation.accumulate()
        pairs = [(k - 1, one["gt_id"] - 1) for k, one in evaluation.cocoDt.anns.items() if "gt_id" in one]
        found, true = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        box[found], overlap[found] = true, [evaluation.cocoDt.anns[k + 1]["iou"] for k in found.tolist()]
        crowd = labels.crowd[true]
        ignored[found] |= crowd
        detection[true[~crowd]] = found[~crowd]
    return Matching(labels, predictions, iou, box, overlap, ignored, detection)
