"""The one list of all types of labels: records, checks, pictures of labels, and docs/dataset.md follow from it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from msgspec import Struct

from hulldown.annotate.coco_types import Record
from hulldown.annotate.label_type import LabeledVehicle, LabelType
from hulldown.annotate.labels.box import SurfaceBox
from hulldown.annotate.labels.box_3d import BoxInCamera
from hulldown.annotate.labels.keypoints import Keypoints
from hulldown.annotate.labels.mask import AmodalMask, VisibleMask
from hulldown.annotate.labels.oriented_box import OrientedBox
from hulldown.annotate.record_fields import LabelRecord, invalid_field_sentences
from hulldown.annotate.records import Category, Image, Label

# In the order of a record's fields.
LABEL_TYPES: tuple[type[LabelType], ...] = (SurfaceBox, BoxInCamera, VisibleMask, AmodalMask, OrientedBox, Keypoints)


def compute_label_fields(vehicle: LabeledVehicle) -> dict[str, object]:
    """Return the fields of a label's record, of all types."""
    return {key: value for kind in LABEL_TYPES for key, value in kind.compute_fields(vehicle).items()}


def invalid_label_field_sentences(record: Record) -> Iterator[str]:
    """Yield a sentence for each field of a label that doesn't have its declared type and range, or is missing."""
    kinds: tuple[type[Struct], ...] = (LabelRecord, *LABEL_TYPES)
    return chain.from_iterable(invalid_field_sentences(record, kind) for kind in kinds)


def label_problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Yield a sentence for each contradiction in a label's values."""
    return chain.from_iterable(label.read(kind).problems(label, image, category) for kind in LABEL_TYPES)
