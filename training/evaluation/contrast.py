"""Measure the contrast of targets with their surroundings, if records don't have it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from hulldown.annotate.masks import decode
from hulldown.dataset.picture_files import read_pixels
from hulldown.dataset.verification.look import appearance
from hulldown.geometry.errors import DatasetError
from hulldown.training.evaluation.labels import Labels

READERS = 4  # threads; decoding releases the interpreter lock


@lru_cache(maxsize=2)  # the detectors of a study are evaluated on the same pictures, one after the other
def measured_contrast(labels: Labels) -> Float[np.ndarray, " g"]:
    """Return the contrast of each target, (g,), 1 for black on white; see `dataset.verification.look`.

    It's nan if a label has no mask, or its picture can't be read.
    """
    found = np.full(len(labels.label), np.nan)
    masked = np.array([bool(record.get("segmentation")) for record in labels.annotations], dtype=bool) & ~labels.crowd
    boxes: dict[int, list[int]] = {}
    for k in np.flatnonzero(masked).tolist():
        boxes.setdefault(int(labels.image[k]), []).append(k)
    with ThreadPoolExecutor(READERS) as pool:
        for rows, contrasts in zip(
            boxes.values(), pool.map(lambda one: _of_image(labels, *one), boxes.items()), strict=True
        ):
            found[rows] = contrasts
    return found


def _of_image(labels: Labels, image: int, boxes: list[int]) -> list[float]:
    record = labels.images[image]
    size = (record["width"], record["height"])
    try:
        picture = read_pixels(labels.folder / record["file_name"], size)
        masks = np.stack([decode(labels.annotations[k]["segmentation"], *size) for k in boxes])
    except (DatasetError, ValueError):  # evaluating doesn't need the picture
        return [np.nan] * len(boxes)
    looks = [appearance(picture, mask, np.delete(masks, row, axis=0).any(axis=0)) for row, mask in enumerate(masks)]
    return [np.nan if look is None else look.contrast / 255.0 for look in looks]
