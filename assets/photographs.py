"""The boxes of photographs as arrays, relative to their pictures, for plans to match and reports to compare."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import orjson
from jaxtyping import Bool, Float, Int
from msgspec import Meta, Struct

from hulldown.assets.foreign_labels import foreign_reader
from hulldown.base.errors import DatasetError
from hulldown.base.outside import DATA, json_of, read_file, typed

NAMES = ("annotations.json", "_annotations.coco.json")
EDGE_SHARE = 0.003  # share of the picture's width or height: a box this near to a side is cut off by it


@dataclass(frozen=True, eq=False, slots=True)
class Photographs:
    """m photographs and their n boxes, by photograph."""

    path: Path  # the COCO file, or the folder of another kind
    sha256: str  # hexadecimal digest of its bytes
    file_names: tuple[str, ...]
    size: Float[np.ndarray, "m 2"]  # width and height, pixels
    image: Int[np.ndarray, " n"]  # ascending: the photograph of each box
    # boxes in the frame: x and width relative to the picture's width, y and height to its height
    xywh: Float[np.ndarray, "n 4"]
    category: tuple[str, ...]
    cut: Bool[np.ndarray, "n 4"]  # whether the picture's left, top, right, and bottom sides cut a box off

    @property
    def height(self) -> Float[np.ndarray, " n"]:
        """Height of each box relative to its picture."""
        return self.xywh[:, 3]

    @property
    def center(self) -> Float[np.ndarray, "n 2"]:
        """Center of each box relative to its picture."""
        return self.xywh[:, :2] + self.xywh[:, 2:] / 2

    @property
    def aspect(self) -> Float[np.ndarray, " n"]:
        """Width over height of each box in pixels."""
        pixels = self.xywh[:, 2:] * self.size[self.image]
        return pixels[:, 0] / pixels[:, 1]

    @property
    def count(self) -> Int[np.ndarray, " m"]:
        """Boxes of each photograph."""
        return np.bincount(self.image, minlength=len(self.file_names))


_Side = Annotated[float, Meta(gt=0, le=1e6)]
_Pixels = Annotated[float, Meta(ge=-1e9, le=1e9)]


class _Record(Struct):
    id: int | str
    width: _Side
    height: _Side
    file_name: str = ""


class _Box(Struct):
    image_id: int | str
    category_id: int | str
    bbox: tuple[_Pixels, _Pixels, _Pixels, _Pixels]
    truncated_fraction: float | None = None


class _Category(Struct):
    id: int | str
    name: str


class _Coco(Struct):
    images: list[_Record]
    annotations: list[Any]
    categories: list[_Category]


def read_photographs(path: Path) -> Photographs:
    """Read the boxes of a COCO file or folder, whose pictures aren't opened, or of a YOLO or VOC folder.

    Regions of many (`iscrowd`) and boxes without area in the frame are left out. Where a record states
    `truncated_fraction`, as this package's do, 0 means that no side cuts the box off, however near it is.
    """
    path, content = _labels(path)
    try:
        coco = json_of(content, _Coco)
        boxes = typed([record for record in coco.annotations if _is_box(record)], list[_Box])
    except ValueError as error:
        raise DatasetError(f"isn't a COCO file ({error})", path=path, remedy="export your labels as COCO") from None
    if twice := [i for i, times in Counter(image.id for image in coco.images).items() if times > 1]:
        raise DatasetError(f"two images have the id {twice[0]!r}", path=path, remedy="give each its own id")
    index = {image.id: i for i, image in enumerate(coco.images)}
    names = {category.id: category.name for category in coco.categories}
    if lost := next((b for b in boxes if b.image_id not in index or b.category_id not in names), None):
        problem = f"a box has image {lost.image_id!r} and category {lost.category_id!r}, and one of them isn't listed"
        raise DatasetError(problem, path=path, remedy="list all images and categories")
    size = np.array([(image.width, image.height) for image in coco.images], dtype=np.float64).reshape(-1, 2)
    image = np.array([index[box.image_id] for box in boxes], dtype=np.int64)
    xywh = np.array([box.bbox for box in boxes], dtype=np.float64).reshape(-1, 4) / np.tile(size[image], 2)
    low, high = np.clip(xywh[:, :2], 0.0, 1.0), np.clip(xywh[:, :2] + xywh[:, 2:], 0.0, 1.0)
    edge = np.maximum(EDGE_SHARE, 1.0 / size[image])
    whole = np.array([box.truncated_fraction == 0.0 for box in boxes], dtype=bool)
    cut = np.concatenate([low <= edge, high >= 1.0 - edge], axis=1) & ~whole[:, None]
    rows = np.argsort(image, kind="stable")
    rows = rows[((high - low) > 0.0).all(axis=1)[rows]]
    return Photographs(
        path,
        hashlib.sha256(content).hexdigest(),
        tuple(image.file_name for image in coco.images),
        size,
        image[rows],
        np.concatenate([low, high - low], axis=1)[rows],
        tuple(names[boxes[i].category_id] for i in rows.tolist()),
        cut[rows],
    )


def _labels(path: Path) -> tuple[Path, bytes]:
    """Return the file or folder of labels, and its COCO as JSON."""
    if path.is_dir():
        coco_path = next((path / name for name in NAMES if (path / name).exists()), None)
        if coco_path is None:
            reader = foreign_reader(path)
            if reader is None:
                remedy = "name a COCO file, or a folder of COCO, YOLO, or VOC as `hulldown train` reads it"
                raise DatasetError(f"no {' and no '.join(NAMES)} here", path=path, remedy=remedy)
            return path, orjson.dumps(reader())
        path = coco_path
    refuse = partial(DatasetError, path=path, remedy="name a COCO file, or a folder with annotations.json")
    return path, read_file(path, refuse, most=DATA)


def _is_box(record: Any) -> bool:
    return not isinstance(record, dict) or (bool(record.get("bbox")) and not record.get("iscrowd"))
