"""Bins of labels by attributes such as size or weather, with figures of each, and sentences about the worst."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain, compress, groupby

import numpy as np
from jaxtyping import Float, Int, Shaped

from hulldown.annotate.masks import decode
from hulldown.assets.picture_files import read_pixels
from hulldown.base.errors import DatasetError
from hulldown.dataset.attributes import SCALES, SIDES, SIZE, bins_of, conditions_of, numbers_of, sides_of
from hulldown.dataset.labels.mask import MASK
from hulldown.dataset.verification.target_appearance import target_appearance
from hulldown.training.evaluation.bootstrap import ratio_error, share_interval
from hulldown.training.evaluation.labels import Labels
from hulldown.training.evaluation.matching import Matching
from hulldown.training.evaluation.metrics import ratio, sums_by
from hulldown.training.evaluation.predictions import Predictions

MOST_NAMES = 30  # most frequent names with their own bin; the others share one
MOST_WORST = 3  # sentences about bins
ENOUGH = 10  # least labels of a bin among the worst
READERS = 4  # threads; decoding releases the interpreter lock


@dataclass(frozen=True, eq=False, slots=True)
class BinnedField:
    """Bins of one attribute of labels."""

    name: str  # name, title: its name in files, and its title for readers
    title: str
    bins: tuple[str, ...]
    of_label: Int[np.ndarray, " g"]  # bin of each label; -1 if unknown
    # bin of each detection, if it doesn't depend on labels; else None: precision is undefined
    of_detection: Int[np.ndarray, " d"] | None


def fields(labels: Labels, predictions: Predictions) -> list[BinnedField]:
    """Return all attributes with bins; those that no label has are left out, as are empty bins.

    Stored values come first; otherwise distance, elevation, side, and slope follow from stored poses, and contrast
    is measured in the pictures.
    """
    numbers = numbers_of(labels.annotations, labels.images, labels.image)
    if (unknown := np.isnan(numbers["contrast"])).any():
        numbers["contrast"] = np.where(unknown, measured_contrast(labels), numbers["contrast"])
    classes = np.where(labels.crowd, -1, labels.class_index)
    found = [
        _field("class", "class", predictions.class_names, classes, predictions.class_index),
        _field(SIZE.name, SIZE.title, SIZE.bins, *(bins_of(_side_length(x), SIZE) for x in (labels, predictions))),
        *(_field(one.name, one.title, one.bins, bins_of(numbers[one.name], one), None) for one in SCALES),
        _field("azimuth_seen", "side seen", SIDES, sides_of(numbers["azimuth"]), None),
        _named("vehicle", "vehicle", [label.vehicle for label in labels.annotations], None),
    ]
    conditions = conditions_of(labels.images)
    for key, title in (("weather_name", "weather"), ("scenery", "scenery"), ("hdri", "HDRI")):
        values = [getattr(each, key) or None for each in conditions]
        names = [values[i] for i in labels.image.tolist()]
        found.append(_named(title.lower(), title, names, [values[i] for i in predictions.image.tolist()]))
    return [field for field in found if (field.of_label[~labels.crowd] >= 0).any()]


@lru_cache(maxsize=2)  # the detectors of a study are evaluated on the same pictures, one after the other
def measured_contrast(labels: Labels) -> Float[np.ndarray, " g"]:
    """Return the contrast of each target, (g,), 1 for black on white; see `dataset.verification.target_appearance`.

    It's nan if a label has no mask, or its picture can't be read.
    """
    found = np.full(len(labels.class_index), np.nan)
    masked = np.array([bool(MASK.read(label).segmentation) for label in labels.annotations], dtype=bool) & ~labels.crowd
    rows = np.flatnonzero(masked)
    by_image = [list(group) for _, group in groupby(rows.tolist(), key=labels.image.__getitem__)]
    with ThreadPoolExecutor(READERS) as pool:
        found[rows] = list(chain.from_iterable(pool.map(partial(_of_image, labels), by_image)))
    return found


def _of_image(labels: Labels, boxes: list[int]) -> list[float]:
    image = labels.images[labels.image[boxes[0]]]
    try:
        picture = read_pixels(labels.folder / image.file_name, image.size)
        masks = np.stack([decode(MASK.read(labels.annotations[k]).segmentation, *image.size) for k in boxes])
    except (DatasetError, ValueError):  # evaluating doesn't need the picture
        return [np.nan] * len(boxes)
    others = (np.delete(masks, row, axis=0).any(axis=0) for row in range(len(masks)))
    looks = [target_appearance(picture, *each) for each in zip(masks, others, strict=True)]
    return [np.nan if look is None else look.contrast / 255.0 for look in looks]


def _side_length(boxes: Labels | Predictions) -> Float[np.ndarray, " n"]:
    return np.sqrt(np.abs(boxes.xywh[:, 2] * boxes.xywh[:, 3]))


def _named(
    name: str, title: str, of_label: Sequence[str | None], of_detection: Sequence[str | None] | None
) -> BinnedField:
    """Bins by name; names beyond the thirty most frequent share one."""
    known = [one for one in of_label if one is not None]
    names = sorted(set(known) | {one for one in of_detection or () if one is not None})
    if len(names) > MOST_NAMES:
        counts = Counter(known)
        kept = sorted(sorted(names, key=lambda one: -counts[one])[:MOST_NAMES])
        names = [*kept, f"{len(names) - MOST_NAMES} others"]
    index: dict[str, int] = {one: i for i, one in enumerate(names)}

    def numbers(values: Sequence[str | None]) -> Int[np.ndarray, " n"]:
        return np.array([-1 if one is None else index.get(one, len(names) - 1) for one in values], dtype=np.int64)

    return _field(name, title, names, numbers(of_label), None if of_detection is None else numbers(of_detection))


def _field(
    name: str,
    title: str,
    bins: Sequence[str],
    of_label: Int[np.ndarray, " g"],
    of_detection: Int[np.ndarray, " d"] | None,
) -> BinnedField:
    """Return a field without empty bins."""
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


def figures_of(field: BinnedField, seen: Matching) -> BinFigures:
    """Recall, precision if defined, and mean IoU in every bin."""
    n = len(field.bins)
    sums = partial(sums_by, seen, of_label=field.of_label, bins=n)
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
        *_share(tp, tp + fn),
        ratio(iou.sum(axis=0), tp.sum(axis=0)),
        detections,
        *_share(right, counted),
    )


def _share(
    part: Float[np.ndarray, "positions b"], whole: Float[np.ndarray, "positions b"]
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, "b 2"]]:
    """Return a ratio of sums over positions, with its interval."""
    trials = whole.sum(axis=0)
    value = ratio(part.sum(axis=0), trials)
    ends = share_interval(value, ratio_error(part, whole), freedom=(whole > 0).sum(axis=0) - 1, trials=trials)
    return value, ends.T


def worst(found: Sequence[BinFigures]) -> list[str]:
    """Return sentences about the bins of the lowest recall, by the upper end of their interval, one per field.

    Bins with fewer labels than `ENOUGH`, or with a recall at or above the overall one, are left out.
    """
    rows = []
    for one in found:
        total = float(ratio(one.found.sum(), one.labels.sum()))
        weak = (one.labels >= ENOUGH) & (one.recall < total) & ~np.isnan(one.recall_interval[:, 0])
        for b in np.flatnonzero(weak):
            low, high = one.recall_interval[b]
            words = (
                f"{one.field.title} {one.field.bins[b]}: {one.found[b]} of {one.labels[b]} found, recall "
                f"{one.recall[b]:.2f} ({low:.2f} to {high:.2f}), against {total:.2f} of all"
            )
            rows.append((float(high), float(low), one.field.name, words))
    picked: dict[str, str] = {}
    for _, _, name, words in sorted(rows):
        picked.setdefault(name, words)
    return list(picked.values())[:MOST_WORST]
