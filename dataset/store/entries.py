"""Check records to be appended and the names of their pictures, and make them plain JSON."""

from __future__ import annotations

import math
import posixpath
from collections.abc import Container, Mapping
from typing import Any

import numpy as np

from hulldown.annotate.coco_types import Record
from hulldown.base.arrays import are_finite_numbers
from hulldown.base.files import is_safe_relative_path
from hulldown.base.outputs import LOCK_NAME, UNFINISHED_NAME

# The dataset's own files: pictures with these names would be removed or overwritten.
RESERVED_KEYS = (
    *("annotations.json", "journal.jsonl", "failures.jsonl", "provenance.json", "logs"),
    *(UNFINISHED_NAME, LOCK_NAME),
)


def normal_file_name(file_name: str) -> str:
    """Return the normal form of a name: ``images/./1.png`` and ``images//1.png`` are the same file.

    >>> normal_file_name("images/./1.png"), normal_file_name("images//1.png")
    ('images/1.png', 'images/1.png')
    """
    return posixpath.normpath(file_name)


def finite_json(value: Any, name: str) -> Any:
    """Convert mappings, sequences, and arrays to plain JSON values; NaN and infinities are refused."""
    if isinstance(value, Mapping):
        return {str(key): finite_json(item, f"{name}: {key}") for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [finite_json(item, name) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{name}: expected finite numbers, got {value}")
    if isinstance(value, bytes):
        return value.decode("ascii")
    return value


def require_valid_image_record(record: Record) -> None:
    """Refuse an image whose file name leaves the dataset or whose size isn't positive."""
    name = record.get("file_name")
    first = normal_file_name(name).casefold().split("/")[0] if is_safe_relative_path(name) else "."
    if first == "." or first in RESERVED_KEYS:
        raise ValueError(f"image: file_name: expected a path inside the dataset that is free, got {name!r:.120}")
    for key in ("width", "height"):
        size = record.get(key)
        if not isinstance(size, int) or size < 1:
            raise ValueError(f"image: {key}: expected a whole number of pixels, got {size!r}")


def require_valid_annotation(record: Record, name: str) -> None:
    """Refuse an annotation without a category or a box."""
    category = record.get("category")
    if not isinstance(category, str) or not category:
        raise ValueError(f"{name}: category: expected a name, got {category!r}")
    box = record.get("bbox")
    if not isinstance(box, list) or len(box) != 4 or not are_finite_numbers(box) or min(box[2:]) < 0:
        raise ValueError(f"{name}: bbox: expected [x, y, width, height] in pixels, got {box!r}")


def new_category(name: str) -> Record:
    """Return the record of a new class; its id is assigned later."""
    return {"id": 0, "name": name, "supercategory": "vehicle"}


def requested_or_next_id(record: Record, name: str, following: int, *used: Container[int]) -> int:
    """Return the id that the record requests, if it's free, or the next one without a request."""
    wanted = record.get("id")
    if wanted is None:
        return following
    if type(wanted) is not int or wanted < 1 or any(wanted in ids for ids in used):
        raise ValueError(f"{name}: id: expected a whole number above 0 that is not in use, got {wanted!r}")
    return wanted
