"""A dataset's classes, images, and labels, made of usable records, which keep all fields of the file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hulldown.assets.coco_types import Coco, Record
from hulldown.base.outside import typed
from hulldown.camera.intrinsics import Intrinsics
from hulldown.dataset.store.declared import Keypoints, LabelRecord, Optics, Pose, fields_of


@dataclass(frozen=True, eq=False, slots=True)
class Category:
    """A class."""

    id: int
    name: str
    keypoints: list[str] | None  # names of its keypoints; None if it has none
    record: Record  # all fields in the file

    @classmethod
    def of(cls, record: Record) -> Category:
        """Return the class in a record, which may be one without a usable name."""
        return cls(record["id"], str(record.get("name")), fields_of(record, Keypoints).keypoints, record)


@dataclass(frozen=True, eq=False, slots=True)
class Label:
    """A label of an image."""

    id: int
    category_id: int
    category: str
    bbox: Float[np.ndarray, "4"]  # x, y, width and height in pixels
    crowd: bool  # whether it's an ignored region
    visible_fraction: float  # visible_fraction, truncated_fraction: shares; nan if unknown
    truncated_fraction: float
    vehicle: str | None  # vehicle, world_from_vehicle: the model's name, and its pose; None if unknown
    world_from_vehicle: Pose | None
    record: Record  # all fields in the file

    @classmethod
    def of(cls, record: Record, names: Mapping[int, str]) -> Label:
        """Return the label in a record; `names` are those of the classes by id."""
        fields = fields_of(record, LabelRecord)
        return cls(
            record["id"],
            fields.category_id,
            names.get(fields.category_id, ""),
            np.array(fields.bbox),
            bool(fields.iscrowd),
            np.nan if fields.visible_fraction is None else fields.visible_fraction,
            np.nan if fields.truncated_fraction is None else fields.truncated_fraction,
            fields.vehicle or None,
            fields.world_from_vehicle,
            record,
        )

    @property
    def fields(self) -> LabelRecord:
        """The declared fields of its record; those that don't fit are missing."""
        return fields_of(self.record, LabelRecord)

    def changed(self, **fields: object) -> Label:
        """Return the label with other values of some fields of its record."""
        return Label.of({**self.record, **fields}, {self.category_id: self.category})


@dataclass(frozen=True, eq=False, slots=True)
class Image:
    """An image."""

    id: int  # id, file_name, width, height: COCO's; the name is relative to the dataset
    file_name: str
    width: int
    height: int
    labels: tuple[Label, ...]  # in the order of the file
    record: Record  # all fields in the file

    @classmethod
    def of(cls, record: Record, labels: Iterable[Label]) -> Image:
        """Return the image in a record."""
        return cls(record["id"], record["file_name"], record["width"], record["height"], tuple(labels), record)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.width, self.height

    @property
    def intrinsics(self) -> Intrinsics | None:
        """The camera; None if the record has none that can be used."""
        try:
            optics = typed(self.record, Optics)
            return Intrinsics.of_fields(*self.size, fov_x_deg=optics.fov_x_deg, K=optics.K, dist=optics.dist)
        except ValueError:
            return None

    def labeled(self, labels: Iterable[Label]) -> Image:
        """Return the image with other labels."""
        return replace(self, labels=tuple(labels))


@dataclass(frozen=True, eq=False, slots=True)
class LabeledImages:
    """All images of a dataset."""

    categories: tuple[Category, ...]  # categories, images: in the order of the file
    images: tuple[Image, ...]
    head: Record  # the other keys of the COCO dictionary

    @classmethod
    def of(cls, coco: Coco) -> LabeledImages:
        """Return the images of a COCO dictionary with usable records, see `dataset.records.check_usable`."""
        categories = tuple(map(Category.of, coco["categories"]))
        names = {category.id: category.name for category in categories}
        of_image: dict[int, list[Label]] = {image["id"]: [] for image in coco["images"]}
        for record in coco["annotations"]:
            of_image[record["image_id"]].append(Label.of(record, names))
        images = tuple(Image.of(image, of_image[image["id"]]) for image in coco["images"])
        head = {key: value for key, value in coco.items() if key not in ("categories", "images", "annotations")}
        return cls(categories, images, head)

    @property
    def names(self) -> dict[int, str]:
        """Category id -> name."""
        return {category.id: category.name for category in self.categories}

    @property
    def classes(self) -> list[Category]:
        """Categories in the order of ids, without parents of others that label nothing, as Roboflow writes them.

        Examples
        --------
        >>> found = [{"id": 0, "name": "army", "supercategory": "none"}]
        >>> found += [{"id": 1, "name": "tank", "supercategory": "army"}]
        >>> coco = {"categories": found, "images": [], "annotations": []}
        >>> [category.name for category in LabeledImages.of(coco).classes]
        ['tank']
        """
        ordered = sorted(self.categories, key=lambda category: category.id)
        used = {label.category_id for image in self.images for label in image.labels}
        # A list, since a foreign record may have a value that can't be hashed.
        parents = [c.record.get("supercategory") for c in ordered if c.record.get("supercategory") != c.name]
        return [category for category in ordered if category.id in used or category.name not in parents]
