"""Recall and precision in bins of class, size, visible share, and distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import compress

import numpy as np
from jaxtyping import Float, Int, Shaped

from hulldown.dataset.attributes import BOX_SIZE_SCALE, SCALES, label_attribute_values, value_bin_indices
from hulldown.training.evaluation.bootstrap import ratio_standard_error, share_interval
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.matching import Matching
from hulldown.training.evaluation.metrics import metric_sums_by_bin, ratio_or_nan
from hulldown.training.evaluation.predictions import Predictions

BINNED_SCALES = ("visible_fraction", "distance")  # keys of `SCALES`


@dataclass(frozen=True, eq=False, slots=True)
class BinnedField:
    """Bins of one attribute of labels."""

    name: str  # name, title: its name in files, and its title for readers
    title: str
    bins: tuple[str, ...]
    of_label: Int[np.ndarray, " g"]  # bin of each label; -1 if unknown
    # bin of each detection, if it doesn't depend on labels; else None: precision is undefined
    of_detection: Int[np.ndarray, " d"] | None


def binned_fields(labels: Labels, predictions: Predictions) -> list[BinnedField]:
    """Return all attributes with bins, but for attributes that no label has, and empty bins."""
    numbers = label_attribute_values(labels.annotations, labels.images, labels.image)
    classes = np.where(labels.crowd, -1, labels.class_index)
    sizes = (value_bin_indices(_root_box_areas(boxes), BOX_SIZE_SCALE) for boxes in (labels, predictions))
    found = [
        _make_binned_field("class", "class", predictions.class_names, classes, predictions.class_index),
        _make_binned_field(BOX_SIZE_SCALE.name, BOX_SIZE_SCALE.title, BOX_SIZE_SCALE.bins, *sizes),
        *(
            _make_binned_field(one.name, one.title, one.bins, value_bin_indices(numbers[one.name], one), None)
            for one in SCALES
            if one.name in BINNED_SCALES
        ),
    ]
    return [field for field in found if (field.of_label[~labels.crowd] >= 0).any()]


def _root_box_areas(boxes: Labels | Predictions) -> Float[np.ndarray, " n"]:
    return np.sqrt(np.abs(boxes.xywh[:, 2] * boxes.xywh[:, 3]))


def _make_binned_field(
    name: str, title: str, bins: Sequence[str], of_label: Int[np.ndarray, " g"], of_detection: Int[np.ndarray, " d"] | None
) -> BinnedField:
    used = of_label if of_detection is None else np.concatenate([of_label, of_detection])
    there = np.bincount(used[used >= 0], minlength=len(bins)) > 0
    new = np.append(np.cumsum(there) - 1, -1)
    kept = tuple(compress(bins, there))
    return BinnedField(name, title, kept, new[of_label], None if of_detection is None else new[of_detection])


@dataclass(frozen=True, eq=False, slots=True)
class BinFigures:
    """Figures of a field's b bins, by their names in reports."""

    field: BinnedField
    labels: Int[np.ndarray, " b"]  # labels, found: number of labels, and of found ones
    found: Int[np.ndarray, " b"]
    # recall, recall_interval: and (b, 2) the 95 % interval; nan with too few positions to tell
    recall: Float[np.ndarray, " b"]
    recall_interval: Float[np.ndarray, "b 2"]
    mean_iou: Float[np.ndarray, " b"]  # mean IoU of the matches
    detections: Shaped[np.ndarray, " b"]  # detections above the threshold; nan if the field has no bins of detections
    # precision, precision_interval: like the recall, for the detections in a bin; nan if undefined
    precision: Float[np.ndarray, " b"]
    precision_interval: Float[np.ndarray, "b 2"]


def figures_by_bin(field: BinnedField, seen: Matching) -> BinFigures:
    """Return recall, precision if it's defined, and mean IoU in every bin."""
    n = len(field.bins)
    sums = partial(metric_sums_by_bin, seen, of_label=field.of_label, bins=n)
    # A match is in its label's bin.
    tp, _, fn, iou, *_ = np.moveaxis(sums(of_detection=np.append(field.of_label, -1)[seen.box]), -1, 0)
    if field.of_detection is None:
        right, counted, detections = np.zeros_like(tp), np.zeros_like(tp), np.full(n, np.nan)
    else:
        right, wrong, *_ = np.moveaxis(sums(of_detection=field.of_detection), -1, 0)
        counted = right + wrong
        detections = counted.sum(axis=0).astype(np.int64)
    return BinFigures(
        field,
        (tp + fn).sum(axis=0).astype(np.int64),
        tp.sum(axis=0).astype(np.int64),
        *_ratio_and_interval(tp, tp + fn),
        ratio_or_nan(iou.sum(axis=0), tp.sum(axis=0)),
        detections,
        *_ratio_and_interval(right, counted),
    )


def _ratio_and_interval(
    part: Float[np.ndarray, "positions b"], whole: Float[np.ndarray, "positions b"]
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, "b 2"]]:
    trials = whole.sum(axis=0)
    value = ratio_or_nan(part.sum(axis=0), trials)
    ends = share_interval(value, ratio_standard_error(part, whole), freedom=(whole > 0).sum(axis=0) - 1, trials=trials)
    return value, ends.T
