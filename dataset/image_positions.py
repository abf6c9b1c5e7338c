"""Positions: groups of images that show the same place, and must not be in training and test at once."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from hulldown.annotate.record_fields import declared_fields
from hulldown.annotate.records import Image


class _Position(Struct):
    """Fields of an image's record by which images belong together."""

    scenery: object = None
    position: object = None


def position_group(image: Image) -> str:
    """Return the group of an image that must stay together: shots of one position show one vehicle on the same ground.

    The first vehicle's position, to the millimeter, identifies the group, so another plan's shots of the same place
    belong to it too. Images without poses, such as photographs, are groups of their own, as are those whose poses
    have another form.
    """
    shot = declared_fields(image.record, _Position)
    for label in image.labels:
        if label.world_from_vehicle is not None and len(label.world_from_vehicle) >= 3:
            place = " ".join(f"{row[3]:.3f}" for row in label.world_from_vehicle[:3])
            return f"{shot.scenery} {label.vehicle} {place}"
    if shot.position is not None:
        return f"{shot.scenery} position {shot.position}"
    return f"image {image.id}"


def group_positions(images: Iterable[Image]) -> dict[str, list[Image]]:
    """Return images by `position_group`, in order."""
    groups: dict[str, list[Image]] = {}
    for image in images:
        groups.setdefault(position_group(image), []).append(image)
    return groups
