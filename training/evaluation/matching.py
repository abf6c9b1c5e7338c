"""COCO's matching of detections with labels, for all images at once.

COCO takes the detections of a class in an image by falling score; each gets the free label with the highest overlap, if
that is at least the threshold. Images and classes are independent, so the n-th detections of all of them are
matched together in one array operation.

References
----------
Lin et al., Microsoft COCO, ECCV 2014; pycocotools 2.0, `COCOeval.evaluateImg`, whose every decision is reproduced.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from hulldown.dataset.labels.oriented_box import visible_corners
from hulldown.geometry.indices import numbered
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.predictions import Predictions

MAX_DETECTIONS = 100  # of a class in an image, COCO's limit
PAIRS_AT_ONCE = 1 << 15  # about, which bounds memory


@dataclass(frozen=True, eq=False, slots=True)
class Overlaps:
    """Detections and labels that overlap, sorted by detection."""

    detection: Int[np.ndarray, " p"]  # detection, box: indices of detection and label
    box: Int[np.ndarray, " p"]
    iou: Float[np.ndarray, " p"]  # their IoU; for crowds, intersection over the detection's area

    def where(self, keep: Bool[np.ndarray, " p"] | Int[np.ndarray, " k"]) -> Overlaps:
        """Select pairs by a mask or by indices."""
        return Overlaps(self.detection[keep], self.box[keep], self.iou[keep])


@dataclass(frozen=True, eq=False, slots=True)
class Matching:
    """Matches of d detections and g labels, and with them the outcome of each."""

    labels: Labels
    predictions: Predictions
    pairs: Overlaps  # the overlaps that the matches are among, of any class
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

    def above(self, threshold: float) -> Matching:
        """Ignore detections with scores below a threshold; the matches of the others don't depend on them."""
        ignored = self.ignored | (self.predictions.score < threshold)
        detection = self.detection.copy()
        detection[self.box[ignored & (self.box >= 0)]] = -1
        return replace(self, ignored=ignored, detection=detection)


def overlaps(
    found: Float[np.ndarray, "p 4"], true: Float[np.ndarray, "p 4"], crowd: Bool[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """IoU of boxes, pair by pair, bit-equal to pycocotools'."""
    ends = np.minimum(found[:, :2] + found[:, 2:], true[:, :2] + true[:, 2:])
    size = ends - np.maximum(found[:, :2], true[:, :2])
    meets = (size > 0.0).all(axis=1)
    shared = np.where(meets, size[:, 0] * size[:, 1], 0.0)
    own = found[:, 2] * found[:, 3]
    union = np.where(crowd, own, own + true[:, 2] * true[:, 3] - shared)
    return np.divide(shared, union, out=np.zeros(len(shared)), where=meets)


def oriented_overlaps(
    found: Float[np.ndarray, "p 4 2"], true: Float[np.ndarray, "p 4 2"], crowd: Bool[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """IoU of convex quadrilaterals by their corners, by Shapely."""
    near = ((found.max(axis=1) > true.min(axis=1)) & (true.max(axis=1) > found.min(axis=1))).all(axis=1)
    result = np.zeros(len(found))
    first, second = shapely.polygons(found[near]), shapely.polygons(true[near])
    shared, own = shapely.area(shapely.intersection(first, second)), shapely.area(first)
    union = np.where(crowd[near], own, own + shapely.area(second) - shared)
    result[near] = np.divide(shared, union, out=np.zeros(len(shared)), where=union > 0.0)
    return result


def overlapping(labels: Labels, predictions: Predictions, *, at_least: float = 0.1) -> Overlaps:
    """Return all pairs of a detection and a label of its image, of any class, with enough overlap.

    Detections beyond the first hundred of their class and image have no pairs. Oriented detections are
    compared with the labels' `dataset.labels.oriented_box.visible_corners`.
    """
    found, true, iou_of = predictions.xywh, labels.xywh, overlaps
    if predictions.corners is not None:
        images = [labels.images[i] for i in labels.image.tolist()]
        corners = list(map(visible_corners, labels.annotations, images))
        found, true, iou_of = predictions.corners, np.reshape(corners, (-1, 4, 2)), oriented_overlaps
    first = np.searchsorted(labels.image, np.arange(len(labels.images) + 1))
    counts = np.where(predictions.place < MAX_DETECTIONS, np.diff(first)[predictions.image], 0)
    ends = np.cumsum(counts)
    cuts = np.searchsorted(ends, np.arange(PAIRS_AT_ONCE, counts.sum(), PAIRS_AT_ONCE)) + 1
    parts = []
    for start, stop in itertools.pairwise([0, *cuts.tolist(), len(counts)]):
        detection, within = numbered(counts[start:stop])
        detection += start
        box = first[predictions.image[detection]] + within
        iou = iou_of(found[detection], true[box], labels.crowd[box])
        parts.append(Overlaps(detection, box, iou).where(iou >= at_least))
    return Overlaps(*(np.concatenate([getattr(part, key) for part in parts]) for key in Overlaps.__slots__))


def match(labels: Labels, predictions: Predictions, pairs: Overlaps, *, iou: float = 0.5) -> Matching:
    """Match detections with labels of their class as COCO does."""
    same = labels.class_index[pairs.box] == predictions.class_index[pairs.detection]
    keep = same & (pairs.iou >= min(iou, 1.0 - 1e-10))
    chosen = greedy(pairs.where(keep), predictions.place, labels.crowd)
    box = np.full(len(predictions.score), -1, dtype=np.int64)
    overlap = np.full(len(predictions.score), np.nan)
    box[chosen.detection], overlap[chosen.detection] = chosen.box, chosen.iou
    ignored = predictions.place >= MAX_DETECTIONS
    ignored[chosen.detection] |= labels.crowd[chosen.box]
    detection = np.full(len(labels.class_index), -1, dtype=np.int64)
    real = chosen.where(~labels.crowd[chosen.box])
    detection[real.box] = real.detection
    return Matching(labels, predictions, pairs, iou, box, overlap, ignored, detection)


def greedy(pairs: Overlaps, turn: Int[np.ndarray, " d"], crowd: Bool[np.ndarray, " g"]) -> Overlaps:
    """Choose for each detection, turn by turn, the free label with the highest overlap.

    `turn`: turn of each detection, from 0; those with a common label have different ones.
    """
    turns = turn[pairs.detection]
    # Of equal overlaps the last label wins, as in COCO's loop.
    best_first = np.lexsort((-pairs.box, -pairs.iou, crowd[pairs.box], pairs.detection, turns))
    starts = np.searchsorted(turns[best_first], np.arange(turns.max(initial=-1) + 2))
    taken = np.zeros(len(crowd), dtype=bool)
    chosen = np.zeros(len(turns), dtype=bool)
    for start, stop in itertools.pairwise(starts):
        rows = best_first[start:stop]
        rows = rows[~taken[pairs.box[rows]]]
        rows = rows[np.diff(pairs.detection[rows], prepend=-1) != 0]
        taken[pairs.box[rows]] = ~crowd[pairs.box[rows]]
        chosen[rows] = True
    return pairs.where(chosen)
