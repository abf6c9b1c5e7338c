"""The declared fields of images, labels, and classes: types and ranges. Records may have any further fields."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any, TypeVar, get_type_hints

import msgspec
from msgspec import Meta, Struct

from hulldown.annotate.coco_types import Record
from hulldown.base.outside import convert_parsed_value

Pixel = Annotated[float, Meta(ge=-1e9, le=1e9)]
Side = Annotated[float, Meta(ge=0, le=1e9)]
Size = Annotated[int, Meta(ge=1, le=2**31 - 1)]
Share = Annotated[float, Meta(ge=0, le=1)]
Meters = Annotated[float, Meta(ge=-1e9, le=1e9)]
Box = tuple[Pixel, Pixel, Pixel, Pixel]
Vector3 = tuple[Meters, Meters, Meters]
Matrix3 = tuple[Vector3, Vector3, Vector3]
Pose = tuple[tuple[Meters, Meters, Meters, Meters], ...]
TEXT_ROUNDING_PX = 1e-6  # rounding error of decimal text
MAX_BOX_OVERHANG_PX = 1.0  # a box may leave its image by this much without being refused
PICTURE_HASH_KEY = "picture_sha256"  # a rendered image's record has its picture file's hash under this key
Declared = TypeVar("Declared", bound=Struct)


class ImageRecord(Struct):
    """Fields of an image that every dataset has."""

    file_name: str
    width: Size
    height: Size


class CameraRecord(Struct):
    """Fields of an image's camera; see `camera.intrinsics.Intrinsics.from_record_fields`."""

    fov_x_deg: Annotated[float, Meta(ge=1e-6, le=179.999)] | None = None
    K: Matrix3 | None = None
    dist: tuple[Meters, Meters, Meters, Meters, Meters] | None = None


class RenderedImageRecord(CameraRecord):
    """Fields of an image that renders have; those of other datasets may mean something else."""

    world_from_camera: Pose | None = None
    background: bool | None = None
    scenery: str | None = None
    hdri: str | None = None
    picture_sha256: str | None = None


class LabelRecord(Struct, kw_only=True):
    """Fields of a label that all readers use; `annotate.labels` has those of the other types."""

    image_id: int
    category_id: int
    bbox: Box
    iscrowd: int | bool | None = None
    visible_fraction: Share | None = None
    truncated_fraction: Share | None = None
    air_contrast: Share | None = None
    world_from_vehicle: Pose | None = None
    vehicle: str | None = None


class CategoryKeypoints(Struct):
    """Fields of a class's keypoints: their names, and pairs of their numbers, from 1."""

    keypoints: list[str] | None = None
    skeleton: list[tuple[int, int]] | None = None


class CategoryRecord(CategoryKeypoints, kw_only=True):
    """Fields of a class."""

    name: Annotated[str, Meta(min_length=1)]


def declared_fields(record: Record, kind: type[Declared]) -> Declared:
    """Return the declared fields of a record; optional ones that don't have their type and range are left out.

    >>> declared_fields({"scenery": "hills", "fov_x_deg": "wide"}, RenderedImageRecord).scenery
    'hills'
    """
    try:
        return convert_parsed_value(record, kind)
    except ValueError:
        wrong = {key for key, _ in _errors_by_field(record, kind)}
        return convert_parsed_value({key: value for key, value in record.items() if key not in wrong}, kind)


def invalid_field_sentences(record: Record, kind: type[Struct]) -> Iterator[str]:
    """Yield a sentence for each field that doesn't have its declared type and range, or is missing."""
    return (f"{key} is {record.get(key)!r:.60} ({error})" for key, error in _errors_by_field(record, kind))


def _errors_by_field(record: Record, kind: type[Struct]) -> Iterator[tuple[str, ValueError]]:
    try:
        convert_parsed_value(record, kind)
        return
    except ValueError:
        pass
    for key, (hint, optional) in _field_types(kind).items():
        if key not in record and optional:
            continue
        try:
            convert_parsed_value(record.get(key), hint)
        except ValueError as error:
            yield key, error


@cache
def _field_types(kind: type[Struct]) -> dict[str, tuple[Any, bool]]:
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: (hints[field.name], not field.required) for field in msgspec.structs.fields(kind)}
