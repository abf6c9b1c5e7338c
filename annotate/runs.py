"""What a dataset sets aside for the images of one plan: ids and file names."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any


@dataclass(frozen=True, slots=True)
class Run:
    """What a dataset has set aside for the images of one plan, the same whenever that plan is resumed.

    Parameters
    ----------
    key
        The plan, for example the SHA-256 of its file.
    image_offset, annotation_offset
        What to add to ids that count from 1 within the plan.
    prefix
        What to put before the plan's file names; empty in a dataset that was empty when the run began.
    images, annotations
        How many ids are set aside.
    """

    key: str
    image_offset: int
    annotation_offset: int
    prefix: str
    images: int
    annotations: int

    def file_name(self, planned: str) -> str:
        """The name in the dataset of the image that the plan calls `planned`."""
        path = PurePosixPath(planned)
        return str(path.with_name(self.prefix + path.name))

    def planned(self, file_name: str) -> str:
        """What the plan calls the image that is called `file_name` in the dataset."""
        path = PurePosixPath(file_name)
        return str(path.with_name(path.name.removeprefix(self.prefix)))

    def has_image(self, image_id: Any) -> Any:
        """Whether an image's id, or which of an array of them, is set aside here."""
        return (image_id > self.image_offset) & (image_id <= self.image_offset + self.images)

    def owns(self, image_id: int, file_name: str) -> bool:
        """Whether an image is one of the plan's: id and name are both set aside here."""
        return bool(self.has_image(image_id)) and PurePosixPath(file_name).name.startswith(self.prefix)

    def has_annotation(self, annotation_id: int) -> bool:
        """Whether an annotation's id is set aside here."""
        return self.annotation_offset < annotation_id <= self.annotation_offset + self.annotations


def plan_key(plan: Path) -> str:
    """What identifies a plan: the SHA-256 of its file."""
    with plan.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def find_run(coco: Mapping[str, Any], key: str) -> Run | None:
    """What a COCO dictionary says was set aside for a plan; None if nothing was."""
    info = coco.get("info")
    runs = info.get("hulldown_runs", []) if isinstance(info, dict) else []
    return next((Run(**record) for record in runs if record["key"] == key), None)
