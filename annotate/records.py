"""A class, an image, and a label, made of usable COCO records, which keep all fields of the file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from hulldown.annotate.coco_types import Record
from hulldown.annotate.record_fields import CameraRecord, CategoryKeypoints, Declared, LabelRecord, Pose, declared_fields
from hulldown.base.outside import convert_parsed_value
from hulldown.camera.intrinsics import Intrinsics


@dataclass(frozen=True, eq=False, slots=True)
class Category:
    """A class of a dataset: fields that are used, and its whole record."""

    id: int
    name: str
    keypoints: list[str] | None  # names of its keypoints; None if it has none
    record: Record  # all fields in the file

    @classmethod
    def from_record(cls, record: Record) -> Category:
        """Return the class in a record, which may be one without a usable name."""
        return cls(record["id"], str(record.get("name")), declared_fields(record, CategoryKeypoints).keypoints, record)


@dataclass(frozen=True, eq=False, slots=True)
class Label:
    """A label: fields that are used, and its whole record."""

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
    def from_record(cls, record: Record, names: Mapping[int, str]) -> Label:
        """Return the label in a record; `names` are those of the classes by id."""
        fields = declared_fields(record, LabelRecord)
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

    def read(self, kind: type[Declared]) -> Declared:
        """Return the fields of a label type in its record; those that don't fit are missing."""
        return declared_fields(self.record, kind)

    def with_fields(self, **fields: object) -> Label:
        """Return the label with other values of some fields of its record."""
        return Label.from_record({**self.record, **fields}, {self.category_id: self.category})


@dataclass(frozen=True, eq=False, slots=True)
class Image:
    """An image of a dataset: fields that are used, its labels, and its whole record."""

    id: int  # id, file_name, width, height: COCO's; the name is relative to the dataset
    file_name: str
    width: int
    height: int
    labels: tuple[Label, ...]  # in the order of the file
    record: Record  # all fields in the file

    @classmethod
    def from_record(cls, record: Record, labels: Iterable[Label]) -> Image:
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
            optics = convert_parsed_value(self.record, CameraRecord)
            return Intrinsics.from_record_fields(*self.size, fov_x_deg=optics.fov_x_deg, K=optics.K, dist=optics.dist)
        except ValueError:
            return None

    def with_labels(self, labels: Iterable[Label]) -> Image:
        """Return the image with other labels."""
        return replace(self, labels=tuple(labels))


def box_overhang_px(bbox: Float[np.ndarray, "4"], width: int, height: int) -> float:
    """Return the pixels that a box reaches beyond its image; at most 0 if it doesn't."""
    x, y, w, h = bbox.tolist()
    return max(-x, -y, x + w - width, y + h - height)
