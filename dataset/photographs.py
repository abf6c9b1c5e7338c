"""The boxes of photographs as arrays, relative to their pictures, for plans to match and reports to compare."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import orjson
from jaxtyping import Bool, Float, Int

from hulldown.annotate.box_table import BoxTable
from hulldown.assets.picture_files import read_picture
from hulldown.base.outside import file_sha256
from hulldown.dataset.record_checks import read_usable_dataset
from hulldown.dataset.store.document import ANNOTATIONS_NAME, COCO_NAME
from hulldown.dataset.usable_labels import images_with_clipped_labels

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
        """Number of boxes of each photograph."""
        return self.boxes_per_image(len(self.file_names))


def read_photographs(path: Path) -> Photographs:
    """Read the boxes of a COCO file or folder, or a YOLO or VOC folder, but crowds and boxes outside the frame."""
    path = next((file for name in (ANNOTATIONS_NAME, COCO_NAME) if (file := path / name).is_file()), path)
    found = read_usable_dataset(path, takes_file=True)
    images = images_with_clipped_labels(found.images, folder=path, clip=False)
    for each in images:
        if os.path.isfile(picture := (path if path.is_dir() else path.parent) / each.file_name):
            read_picture(picture, each.size, largest=0)
    boxes = [(i, label) for i, each in enumerate(images) for label in each.labels if not label.crowd]
    records = {"images": [image.record for image in found.images]}
    records["annotations"] = [label.record for image in found.images for label in image.labels]
    records["categories"] = [category.record for category in found.categories]
    digest = hashlib.sha256(orjson.dumps(records)).hexdigest() if path.is_dir() else file_sha256(path)
    classes = [category.id for category in found.categories]
    size = np.array([each.size for each in images], dtype=np.float64).reshape(-1, 2)
    image = np.array([i for i, _ in boxes], dtype=np.int64)
    xywh = np.array([label.bbox for _, label in boxes], dtype=np.float64).reshape(-1, 4)
    shares = xywh / np.tile(size[image], 2)
    low, high = np.clip(shares[:, :2], 0.0, 1.0), np.clip(shares[:, :2] + shares[:, 2:], 0.0, 1.0)
    edge = np.maximum(EDGE_DISTANCE_SHARE, 1.0 / size[image])
    whole = np.array([label.truncated_fraction == 0.0 for _, label in boxes], dtype=bool)
    cut = np.concatenate([low <= edge, high >= 1.0 - edge], axis=1) & ~whole[:, None]
    return Photographs(
        class_names=tuple(category.name for category in found.categories),
        image=image,
        class_index=np.array([classes.index(label.category_id) for _, label in boxes], dtype=np.int64),
        xywh=xywh,
        path=path,
        sha256=digest,
        file_names=tuple(image.file_name for image in images),
        size=size,
        relative=np.concatenate([low, high - low], axis=1),
        cut=cut,
    )
