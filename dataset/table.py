"""A dataset for notebooks and reports: its images, tables of their labels, and labeled pictures."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Shaped
from PIL import Image as Pictures

from hulldown.annotate.coco_types import Record
from hulldown.annotate.drawing import Overlay, picture_with_labels
from hulldown.assets.picture_files import read_pixels
from hulldown.base.errors import DatasetError
from hulldown.base.indices import even_sample
from hulldown.dataset.attributes import (
    BOX_SIZE_SCALE,
    SCALES,
    SEEN_SIDES,
    image_conditions,
    label_attribute_values,
    seen_side_indices,
)
from hulldown.dataset.images import LabeledImages
from hulldown.dataset.record_checks import read_usable_dataset
from hulldown.dataset.row_records import planned_label_records, recorded_image_fields
from hulldown.pictures.notebooks import ShownInNotebooks
from hulldown.pictures.sheets import contact_sheet
from hulldown.plan.plan_file import Plan

DatasetColumns = dict[str, Shaped[np.ndarray, " n"]]
CONDITION_TITLES = {"scenery": "scenery", "hdri": "HDRI", "weather": "weather"}  # columns that name an image's, with titles


class Dataset(ShownInNotebooks):
    """Images with their labels, of a dataset or of a plan.

    Parameters
    ----------
    name
        Its source.
    found
        Its images.
    opened
        Function from an image to its picture without labels.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from hulldown.dataset.coco import CocoDataset
    >>> folder = mkdtemp()
    >>> label = {"category": "truck", "bbox": [1, 2, 3, 4]}
    >>> with CocoDataset.open(folder) as writer:
    ...     _ = writer.append({"file_name": "images/1.png", "width": 64, "height": 48}, [label])
    >>> dataset = Dataset.read(folder)
    >>> dataset.images[0].labels[0].category
    'truck'
    >>> dataset.labels["box_size"].round(2)
    array([3.46])
    """

    def __init__(self, name: str, found: LabeledImages, opened: Callable[[int], Pictures.Image]) -> None:
        self.name = name
        self.categories = found.category_names_by_id
        self.images = found.images
        self._opened = opened

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> Dataset:
        """Read the dataset in a folder, of photographs too.

        Raises
        ------
        DatasetError
            If there is none, or a record is unusable.
        """
        folder = Path(folder)
        found = read_usable_dataset(folder)
        paths = [folder / image.file_name for image in found.images]
        return cls(str(folder), found, lambda i: Pictures.fromarray(read_pixels(paths[i], found.images[i].size)))

    @classmethod
    def of_plan(cls, plan: Plan, picture: Callable[[int], Pictures.Image]) -> Dataset:
        """Return the dataset that a plan will become; `picture` returns a row's picture, such as its preview.

        Raises
        ------
        ConfigError
            If a row of the plan is damaged.
        """
        ids = {name: number for number, name in enumerate(plan.header.categories, start=1)}
        images: list[Record] = []
        labels: list[Record] = []
        for row in plan:
            images.append({"id": row.image_id, "file_name": row.file_name, **recorded_image_fields(row)})
            for k, label in enumerate(planned_label_records(row)):
                of_image = {"id": k, "image_id": row.image_id, "category_id": ids[label["category"]]}
                labels.append({**label, **of_image})
        categories: list[Record] = [{"id": number, "name": name} for name, number in ids.items()]
        found = LabeledImages.from_coco_dict({"categories": categories, "images": images, "annotations": labels})
        return cls(str(plan.path), found, picture)

    def picture(self, i: int, *, labels: bool = True, masks: bool = True) -> Pictures.Image:
        """Return the picture of the i-th image, by default with boxes, class names, and masks.

        Raises
        ------
        DatasetError
            If it cannot be read.
        """
        image = self._opened(i)
        if not labels:
            return image
        boxes = [
            Overlay(label.bbox, label.category_id, label.category, ignored=label.crowd, record=label.record)
            for label in self.images[i].labels
        ]
        try:
            return picture_with_labels(image, boxes, tint=masks)
        except ValueError as error:
            problem = f"{self.images[i].file_name}: {error}"
            raise DatasetError(problem, remedy="check the dataset with `hulldown verify`") from error

    def sheet(self, *, count: int = 24, columns: int = 4, tile_width: int = 480, masks: bool = True) -> Pictures.Image:
        """Return a contact sheet of labeled pictures, an even selection of the dataset.

        Raises
        ------
        DatasetError
            If the dataset has no images, or one of them can't be read.
        """
        if not self.images:
            raise DatasetError("has no images yet", path=self.name, remedy="render some first")
        chosen = even_sample(len(self.images), count).tolist()
        return contact_sheet([self.picture(i, masks=masks) for i in chosen], columns=columns, tile_width=tile_width)

    def __len__(self) -> int:
        return len(self.images)

    def __fspath__(self) -> str:
        return self.name

    def __repr__(self) -> str:
        return f"Dataset({self.name!r}, {len(self):,} images)"

    def _table_facts(self) -> dict[str, object]:
        classes, counts = np.unique([label.category for image in self.images for label in image.labels], return_counts=True)
        labels = {f"labels of {name}": f"{n:,}" for name, n in zip(classes.tolist(), counts.tolist(), strict=True)}
        return {"images": f"{len(self):,}", **labels}

    def _notebook_picture(self) -> Pictures.Image:
        return self.sheet(count=6, columns=3, tile_width=320)

    @cached_property
    def labels(self) -> DatasetColumns:
        """A table of labels: columns by name, one row per label, for pandas, polars, and NumPy.

        ``image`` is the row of `of_images`. Unknown numbers are nan, unknown names empty; lengths are in meters
        or pixels, angles in degrees.
        """
        rows = [(i, label) for i, image in enumerate(self.images) for label in image.labels]
        index = np.array([i for i, _ in rows], dtype=np.int64)
        boxes = np.array([label.bbox for _, label in rows], dtype=np.float64).reshape(-1, 4)
        numbers = label_attribute_values([label for _, label in rows], self.images, index)
        return {
            "image": index,
            "id": np.array([label.id for _, label in rows], dtype=np.int64),
            "category": np.array([label.category for _, label in rows], dtype=str),
            **dict(zip(("x", "y", "width", "height"), boxes.T, strict=True)),
            BOX_SIZE_SCALE.name: np.sqrt(np.abs(boxes[:, 2] * boxes[:, 3])),
            "crowd": np.array([label.crowd for _, label in rows], dtype=bool),
            **{scale.name: numbers[scale.name] for scale in SCALES},
            "azimuth": numbers["azimuth"],
            "side": np.array([*SEEN_SIDES, ""])[seen_side_indices(numbers["azimuth"])],
            "vehicle": np.array([label.vehicle or "" for _, label in rows], dtype=str),
            **{key: self.of_images[key][index] for key in CONDITION_TITLES},
        }

    @cached_property
    def of_images(self) -> DatasetColumns:
        """A table of images, like `labels`."""
        conditions = image_conditions(self.images)
        scalars = (("id", np.int64), ("file_name", str), ("width", np.int64), ("height", np.int64))
        return {
            **{key: np.array([getattr(image, key) for image in self.images], dtype=kind) for key, kind in scalars},
            "labels": np.array([len(image.labels) for image in self.images], dtype=np.int64),
            "position": np.array([each.position for each in conditions], dtype=np.float64),
            "fov_x_deg": np.array([each.fov_x_deg for each in conditions], dtype=np.float64),
            "strength": np.array([each.strength for each in conditions], dtype=np.float64),
            "scenery": np.array([each.scenery or "" for each in conditions], dtype=str),
            "hdri": np.array([each.hdri or "" for each in conditions], dtype=str),
            "weather": np.array([each.weather_bin_name for each in conditions], dtype=str),
        }
