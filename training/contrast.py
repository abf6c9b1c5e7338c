"""How targets stand out in their pictures, measured where records do not say it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from annotate.masks import decode
from dataset.look import appearance
from geometry.errors import DatasetError
from training.labels import Labels
from training.sources import read_picture

MOST_LOOKED_AT = 5000  # pictures: reading more would take longer than all the rest of an evaluation


def measured_contrast(labels: Labels) -> Float[np.ndarray, " g"]:
    """(g,) contrast of each target, 1 for black on white, as `dataset.look` measures it in its picture.

    nan where a label has no mask, its picture cannot be read, and everywhere in datasets of more than
    `MOST_LOOKED_AT` images with masks.
    """
    found = np.full(len(labels.label), np.nan)
    masked = np.array([bool(record.get("segmentation")) for record in labels.annotations], dtype=bool) & ~labels.crowd
    images = np.unique(labels.image[masked]).tolist()
    if len(images) > MOST_LOOKED_AT:
        return found
    for i in images:
        record = labels.images[i]
        size = (record["width"], record["height"])
        boxes = np.flatnonzero(masked & (labels.image == i)).tolist()
        try:
            picture = read_picture(labels.folder / record["file_name"], size)
            masks = np.stack([decode(labels.annotations[k]["segmentation"], *size) for k in boxes])
        except (DatasetError, ValueError):  # a picture that is not there costs no figure
            continue
        for row, k in enumerate(boxes):
            look = appearance(picture, masks[row], np.delete(masks, row, axis=0).any(axis=0))
            found[k] = np.nan if look is None else look.contrast / 255.0
    return found
