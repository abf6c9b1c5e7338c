"""What is known about labels, such as size, distance or weather, and bins of it that are the same for every dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from dataset.known import SCALES, SIDES, SIZE, bins_of, name_of, numbers_of, sides_of, weather_of
from training.contrast import measured_contrast
from training.labels import Labels
from training.predictions import Predictions

MOST_NAMES = 30  # bins of a field of names, the most frequent; the others share one


@dataclass(frozen=True, eq=False, slots=True)
class Field:
    """Bins of one thing that is known about labels.

    Parameters
    ----------
    name, title
        What it is called in files, and for readers.
    bins
        b names, in their order.
    of_label
        (g,) the bin of each label; -1 where it is not known.
    of_detection
        (d,) the same of detections, where it does not take a label to know it; else None: precision is not defined.
    """

    name: str
    title: str
    bins: tuple[str, ...]
    of_label: Int[np.ndarray, " g"]
    of_detection: Int[np.ndarray, " d"] | None


def fields(labels: Labels, predictions: Predictions) -> list[Field]:
    """Everything that labels can be put into bins by; what no label knows is left out, as are empty bins.

    What is stored comes first; distance, elevation, side and slope are else derived from stored poses, and contrast
    is measured in the pictures.
    """
    numbers = numbers_of(labels.annotations, labels.images, labels.image)
    if (unknown := np.isnan(numbers["contrast"])).any():
        numbers["contrast"] = np.where(unknown, measured_contrast(labels), numbers["contrast"])
    found = [
        Field("class", "class", predictions.class_names, np.where(labels.crowd, -1, labels.label), predictions.label),
        Field(
            SIZE.name,
            SIZE.title,
            SIZE.bins,
            bins_of(_side_length(labels), SIZE),
            bins_of(_side_length(predictions), SIZE),
        ),
    ]
    found += [Field(one.name, one.title, one.bins, bins_of(numbers[one.name], one), None) for one in SCALES]
    found.append(Field("azimuth_seen", "side seen", SIDES, sides_of(numbers["azimuth"]), None))
    found.append(_named("vehicle", "vehicle", [name_of(box.get("vehicle")) for box in labels.annotations], None))
    for key, title, of in (
        ("weather", "weather", weather_of),
        ("scenery", "scenery", name_of),
        ("hdri", "HDRI", name_of),
    ):
        values = [of(image.get(key)) if key in image else None for image in labels.images]
        names = [values[i] for i in labels.image.tolist()]
        found.append(_named(key, title, names, [values[i] for i in predictions.image.tolist()]))
    return [_without_empty(field) for field in found if (np.where(labels.crowd, -1, field.of_label) >= 0).any()]


def _side_length(boxes: Labels | Predictions) -> Float[np.ndarray, " n"]:
    return np.sqrt(np.abs(boxes.xywh[:, 2] * boxes.xywh[:, 3]))


def _named(
    name: str,
    title: str,
    of_label: Sequence[str | None],
    of_detection: Sequence[str | None] | None,
    *,
    order: Sequence[str] | None = None,
) -> Field:
    """Bins by name; those beyond the thirty most frequent share one."""
    known = [one for one in of_label if one is not None]
    names = sorted(set(known) | {one for one in of_detection or () if one is not None})
    if order is not None:
        names = [one for one in order if one in names]
    elif len(names) > MOST_NAMES:
        counts = Counter(known)
        kept = sorted(sorted(names, key=lambda one: -counts[one])[:MOST_NAMES])
        names = [*kept, f"{len(names) - MOST_NAMES} others"]
    index: dict[str, int] = {one: i for i, one in enumerate(names)}

    def numbers(values: Sequence[str | None]) -> Int[np.ndarray, " n"]:
        return np.array([-1 if one is None else index.get(one, len(names) - 1) for one in values], dtype=np.int64)

    return Field(name, title, tuple(names), numbers(of_label), None if of_detection is None else numbers(of_detection))


def _without_empty(field: Field) -> Field:
    used = [field.of_label] if field.of_detection is None else [field.of_label, field.of_detection]
    there = np.bincount(np.concatenate([one[one >= 0] for one in used]), minlength=len(field.bins)) > 0
    new = np.append(np.cumsum(there) - 1, -1)
    return Field(
        field.name,
        field.title,
        tuple(name for name, kept in zip(field.bins, there, strict=True) if kept),
        new[field.of_label],
        None if field.of_detection is None else new[field.of_detection],
    )
