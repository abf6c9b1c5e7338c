"""A sheet of a dataset's pictures with their annotations on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from hulldown.annotate.drawing import contact_sheet
from hulldown.dataset.table import Dataset
from hulldown.geometry.errors import DatasetError


def dataset_sheet(
    folder: Path | str, *, count: int = 24, columns: int = 4, tile_width: int = 480, masks: bool = True
) -> Image.Image:
    """Return a contact sheet of a dataset's pictures, evenly taken from its whole length.

    Raises
    ------
    DatasetError
        If the dataset has no images, or one of them cannot be read.
    """
    dataset = Dataset.read(folder)
    if not dataset.images:
        raise DatasetError("has no images yet", path=Path(folder), remedy="render some first")
    spread = np.linspace(0, len(dataset.images) - 1, min(count, len(dataset.images)))
    chosen = np.unique(spread.round().astype(int)).tolist()
    return contact_sheet([dataset.picture(i, masks=masks) for i in chosen], columns=columns, tile_width=tile_width)
