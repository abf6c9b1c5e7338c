"""A sheet of a dataset's pictures with their annotations on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from annotate.drawing import contact_sheet, draw
from dataset.picture_files import read_pixels
from dataset.records import by_image, read_usable
from geometry.errors import DatasetError


def dataset_sheet(
    folder: Path | str, *, count: int = 24, columns: int = 4, tile_width: int = 480, masks: bool = True
) -> Image.Image:
    """A contact sheet of pictures of a dataset, evenly taken from its whole length.

    Raises
    ------
    DatasetError
        If the dataset has no images, or one of them cannot be read.
    """
    folder = Path(folder)
    coco = read_usable(folder)
    images = coco["images"]
    if not images:
        raise DatasetError("has no images yet", path=folder, remedy="render some first")
    names = {category["id"]: category["name"] for category in coco["categories"]}
    spread = np.linspace(0, len(images) - 1, min(count, len(images)))
    chosen = [images[i] for i in np.unique(spread.round().astype(int))]
    mine = by_image(chosen, coco["annotations"])
    pictures = []
    for image in chosen:
        path = folder / image["file_name"]
        picture = Image.fromarray(read_pixels(path))
        try:
            pictures.append(draw(picture, mine[image["id"]], names, masks=masks))
        except ValueError as error:
            raise DatasetError(str(error), path=path, remedy="check the dataset with `hulldown verify`") from error
    return contact_sheet(pictures, columns=columns, tile_width=tile_width)
