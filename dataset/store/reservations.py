"""A dataset's reservation of ids and file names for a plan."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Annotated, TypeAlias

import msgspec

from hulldown.annotate.coco_types import Record
from hulldown.base.outside import convert_value, file_sha256

_Count: TypeAlias = Annotated[int, msgspec.Meta(ge=0)]


class Reservation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Ids and file names reserved for a plan's images, the same whenever the plan is resumed."""

    key: Annotated[str, msgspec.Meta(pattern=r"^[^/]+\Z")]  # the plan's key, the SHA-256 of its file
    image_offset: _Count  # image_offset, annotation_offset: offsets of ids, which count from 1 within the plan
    annotation_offset: _Count
    # prefix of the plan's file names; empty in a dataset that was empty before
    prefix: Annotated[str, msgspec.Meta(pattern=r"^[^/]*\Z")]
    images: _Count
    annotations: _Count

    def dataset_file_name(self, planned: str) -> str:
        """Return the dataset's name of an image that is `planned` in the plan."""
        path = PurePosixPath(planned)
        return str(path.with_name(self.prefix + path.name))

    def planned(self, file_name: str) -> str:
        """Return the plan's name of an image that is `file_name` in the dataset."""
        path = PurePosixPath(file_name)
        return str(path.with_name(path.name.removeprefix(self.prefix)))

    def has_image_id(self, image_id: int) -> bool:
        """Return whether this reserves an image's id."""
        return self.image_offset < image_id <= self.image_offset + self.images

    def owns_image(self, image_id: int, file_name: str) -> bool:
        """Return whether an image is the plan's: this reserves both its id and its name."""
        return self.has_image_id(image_id) and PurePosixPath(file_name).name.startswith(self.prefix)

    def has_annotation_id(self, annotation_id: int) -> bool:
        """Return whether this reserves an annotation's id."""
        return self.annotation_offset < annotation_id <= self.annotation_offset + self.annotations


def plan_file_key(plan: Path) -> str:
    """Return a plan's key: the SHA-256 of its file."""
    return file_sha256(plan)


def coco_reservations(coco: Record) -> list[Reservation]:
    """Return the reservations for plans in a COCO dictionary; ValueError if they are damaged."""
    info = coco.get("info")
    return convert_value(info.get("hulldown_runs", []) if isinstance(info, dict) else [], list[Reservation])


def find_reservation(coco: Record, key: str) -> Reservation | None:
    """Return the reservation for a plan in a COCO dictionary; None if there is none."""
    return next((reservation for reservation in coco_reservations(coco) if reservation.key == key), None)
