"""Ground truth: a COCO dataset's labels as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.annotate.box_table import BoxTable
from hulldown.annotate.labels.mask import label_area
from hulldown.annotate.records import Image, Label
from hulldown.base.errors import DatasetError
from hulldown.dataset.images import LabeledImages, position_group_key
from hulldown.dataset.record_checks import read_usable_dataset


@dataclass(frozen=True, eq=False, kw_only=True)
class Labels(BoxTable):
    """The labels of n images: g boxes of c classes, images and classes in the order of their ids."""

    path: Path  # the dataset's folder, or its file
    class_id: Int[np.ndarray, " c"]
    area: Float[np.ndarray, " g"]  # pixels: the record's area (a mask's, if there is one), else the box's
    crowd: Bool[np.ndarray, " g"]  # whether it's COCO's ``iscrowd``, which is ignored
    images: Sequence[Image]  # images, annotations: the images and labels themselves, in the same order
    annotations: Sequence[Label]

    @property
    def folder(self) -> Path:
        """Folder of the pictures."""
        return self.path if self.path.is_dir() else self.path.parent

    @cached_property
    def position(self) -> Int[np.ndarray, " n"]:
        """(n,) position of each image; an image without one is its own."""
        return np.unique([position_group_key(image) for image in self.images], return_inverse=True)[1]

    @property
    def positions(self) -> int:
        """Number of positions, which are mutually independent."""
        return int(self.position.max(initial=-1)) + 1


def read_labels(path: Path | str) -> Labels:
    """Read the labels of a dataset."""
    return labels_from_images(read_usable_dataset(Path(path), takes_file=True), path=Path(path))


def labels_from_images(found: LabeledImages, *, path: Path) -> Labels:
    """Return the labels of a dataset's images."""
    # By image, then in the file's order, so the order of images in the file doesn't matter.
    images = sorted(found.images, key=lambda image: image.id)
    categories = sorted(found.categories, key=lambda category: category.id)
    index_of = {category.id: i for i, category in enumerate(categories)}
    labels = [label for image in images for label in image.labels]
    xywh = np.array([label.bbox for label in labels], dtype=np.float64).reshape(-1, 4)
    if negative := [str(labels[k].id) for k in np.flatnonzero((xywh[:, 2:] < 0).any(axis=1))]:
        more = f" and {len(negative) - 10} more" if len(negative) > 10 else ""
        problem = f"boxes have a negative width or height: annotation {', '.join(negative[:10])}{more}"
        raise DatasetError(problem, path=path, remedy="correct them")
    return Labels(
        path=path,
        class_id=np.array([category.id for category in categories], dtype=np.int64),
        class_names=tuple(category.name for category in categories),
        image=np.repeat(np.arange(len(images)), [len(image.labels) for image in images]),
        class_index=np.array([index_of[label.category_id] for label in labels], dtype=np.int64),
        xywh=xywh,
        area=np.array([label_area(label) for label in labels], dtype=np.float64),
        crowd=np.array([label.crowd for label in labels], dtype=bool),
        images=images,
        annotations=labels,
    )
