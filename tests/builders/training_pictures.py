"""Datasets that a detector learns quickly: bright shapes on dark noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from hulldown.annotate.masks import encode_mask
from hulldown.tests.builders.editing import write_dataset

CLASSES = ("square", "disc")


def make_dataset(folder: Path, count: int, *, seed: int = 0, classes=CLASSES, masks=True) -> Path:
    """`count` pictures of 96 x 54 with a shape each, except every fourth."""
    (folder / "images").mkdir(parents=True)
    rng = np.random.default_rng(seed)
    width, height = 96, 54
    images, annotations = [], []
    for i in range(count):
        picture = rng.integers(0, 60, (height, width, 3), dtype=np.uint8)
        image = {"file_name": f"images/{i:04}.png", "width": width, "height": height}
        if i % 4 != 3:
            label, side = i % 2, int(rng.integers(height // 4, height // 2))
            x, y = int(rng.integers(0, width - side)), int(rng.integers(0, height - side))
            rows, columns = np.ogrid[:height, :width]
            if label == 0:
                mask = (columns >= x) & (columns < x + side) & (rows >= y) & (rows < y + side)
            else:
                mask = np.hypot(columns + 0.5 - x - side / 2, rows + 0.5 - y - side / 2) <= side / 2
            picture[mask] = (220, 60, 40) if label == 0 else (40, 200, 230)
            record = {
                "id": i + 1,
                "image_id": i + 1,
                "category_id": label + 1,
                "bbox": [x, y, side, side],
                "area": int(mask.sum()),
                "iscrowd": 0,
                "segmentation": encode_mask(mask) if masks else [],
            }
            annotations.append(record)
        images.append(image)
        Image.fromarray(picture).save(folder / image["file_name"])
    return write_dataset(folder, images, annotations, names=classes)


def make_datasets(folder: Path, **counts: int) -> Path:
    """A folder with a dataset of this name and number of pictures for each argument."""
    for seed, (name, count) in enumerate(counts.items()):
        make_dataset(folder / name, count, seed=seed)
    return folder
