"""The boxes of photographs as arrays, relative to their pictures, for plans to match and reports to compare."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import orjson
from jaxtyping import Bool, Float, Int
from msgspec import Meta, Struct

from hulldown.annotate.box_table import BoxTable
from hulldown.annotate.record_fields import Box
from hulldown.base.errors import DatasetError
from hulldown.base.outside import file_sha256, parse_value
from hulldown.dataset.store.document import ANNOTATIONS_NAME, COCO_NAME, read_coco

EDGE_DISTANCE_SHARE = 0.003  # of the picture's width or height: a side cuts off a box that is this near to it


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Photographs(BoxTable):
    """m photographs and their n boxes."""

    path: Path  # the COCO file, or the folder of another kind
    sha256: str  # hexadecimal digest of its bytes
    file_names: tuple[str, ...]
    size: Float[np.ndarray, "m 2"]  # width and height, pixels
    # boxes in the frame: x and width relative to the picture's width, y and height to its height
    relative: Float[np.ndarray, "n 4"]
    cut: Bool[np.ndarray, "n 4"]  # whether the picture's left, top, right, and bottom sides cut a box off

    @property
    def height(self) -> Float[np.ndarray, " n"]:
        """Height of each box relative to its picture."""
        return self.relative[:, 3]

    @property
    def center(self) -> Float[np.ndarray, "n 2"]:
        """Center of each box relative to its picture."""
        return self.relative[:, :2] + self.relative[:, 2:] / 2

    @property
    def aspect(self) -> Float[np.ndarray, " n"]:
        """Width over height of each box in pixels."""
        pixels = self.relative[:, 2:] * self.size[self.image]
        return pixels[:, 0] / pixels[:, 1]

    @property
    def count(self) -> Int[np.ndarray, " m"]:
        """Boxes of each photograph."""
        return self.boxes_per_image(len(self.file_names))


class _Size(Struct):
    width: Annotated[float, Meta(gt=0, le=1e6)]
    height: Annotated[float, Meta(gt=0, le=1e6)]


class _Box(Struct):
    image_id: int
    category_id: int
    bbox: Box
    truncated_fraction: float | None = None


def read_photographs(path: Path) -> Photographs:
    """Read the boxes of a COCO file or folder, or a YOLO or VOC folder, without crowds and boxes outside the frame."""
    path = next((file for name in (ANNOTATIONS_NAME, COCO_NAME) if (file := path / name).is_file()), path)
    coco = read_coco(path)
    digest = hashlib.sha256(orjson.dumps(coco)).hexdigest() if path.is_dir() else file_sha256(path)
    classes = {category["id"]: k for k, category in enumerate(coco["categories"])}
    index = {image["id"]: i for i, image in enumerate(coco["images"])}
    if len(index) < len(coco["images"]):
        raise DatasetError("two images have the same id", path=path, remedy="give each its own id")
    try:
        sizes = parse_value(coco["images"], list[_Size])
        shown = (record for record in coco["annotations"] if record.get("bbox") and not record.get("iscrowd"))
        boxes = parse_value(list(shown), list[_Box])
    except ValueError as error:
        raise DatasetError(f"isn't a COCO file ({error})", path=path, remedy="export your labels as COCO") from None
    if lost := next((b for b in boxes if b.image_id not in index or b.category_id not in classes), None):
        problem = f"a box has image {lost.image_id!r} and category {lost.category_id!r}, and one of them isn't listed"
        raise DatasetError(problem, path=path, remedy="list all images and categories")
    size = np.array([(image.width, image.height) for image in sizes], dtype=np.float64).reshape(-1, 2)
    image = np.array([index[box.image_id] for box in boxes], dtype=np.int64)
    xywh = np.array([box.bbox for box in boxes], dtype=np.float64).reshape(-1, 4)
    shares = xywh / np.tile(size[image], 2)
    low, high = np.clip(shares[:, :2], 0.0, 1.0), np.clip(shares[:, :2] + shares[:, 2:], 0.0, 1.0)
    edge = np.maximum(EDGE_DISTANCE_SHARE, 1.0 / size[image])
    whole = np.array([box.truncated_fraction == 0.0 for box in boxes], dtype=bool)
    cut = np.concatenate([low <= edge, high >= 1.0 - edge], axis=1) & ~whole[:, None]
    rows = np.argsort(image, kind="stable")
    rows = rows[((high - low) > 0.0).all(axis=1)[rows]]
    return Photographs(
        class_names=tuple(str(category.get("name")) for category in coco["categories"]),
        image=image[rows],
        class_index=np.array([classes[box.category_id] for box in boxes], dtype=np.int64)[rows],
        xywh=xywh[rows],
        path=path,
        sha256=digest,
        file_names=tuple(str(image.get("file_name", "")) for image in coco["images"]),
        size=size,
        relative=np.concatenate([low, high - low], axis=1)[rows],
        cut=cut[rows],
    )
