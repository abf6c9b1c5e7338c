"""The types of a COCO dictionary: JSON as other people's tools write it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NotRequired, TypeAlias, TypedDict

Record: TypeAlias = Mapping[str, Any]  # may have any further fields


class Coco(TypedDict):
    """A dataset as a COCO dictionary, which may have any further keys."""

    categories: list[Record]
    images: list[Record]
    annotations: list[Record]
    info: NotRequired[Any]
