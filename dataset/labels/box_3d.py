"""The 3D box of a label in its camera's frame, with its distance and the side that the camera sees."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.labels.label_type import LabelType
from hulldown.dataset.store.declared import Rows, Three
from hulldown.geometry.portable import arctan2
from hulldown.geometry.transforms import product
from hulldown.planning.plan.row import PlannedVehicle, Row

DIGITS = 9  # to a nanometer, so that every processor gives the same
TOLERANCE = 1e-6
OVERHEAD = 1e-6  # radians from straight above, within which a camera has no azimuth


class Box3D(Struct):
    """An oriented box in the camera's frame."""

    center: Three
    size: Three
    rotation: Rows


class Fields(Struct):
    """See `space_of`."""

    distance: Annotated[float, Meta(ge=0, le=1e9)] | None = None
    azimuth_seen: Annotated[float, Meta(ge=-10, le=10)] | None = None
    bbox_3d: Box3D | None = None


def space_of(vehicle: PlannedVehicle, row: Row) -> Fields:
    """Return a label's fields about the vehicle's position in the camera's frame."""
    low, high = np.array(vehicle.bounds.low), np.array(vehicle.bounds.high)
    world_from_vehicle, world_from_camera = vehicle.world_from_vehicle, row.world_from_camera
    camera_from_world = world_from_camera[:3, :3].T
    rotation = product(camera_from_world, world_from_vehicle[:3, :3])
    middle = product(world_from_vehicle[:3, :3], ((low + high) / 2.0)[:, None])[:, 0] + world_from_vehicle[:3, 3]
    away = middle - world_from_camera[:3, 3]
    center = product(camera_from_world, away[:, None])[:, 0]
    ahead, left, _ = product(world_from_vehicle[:3, :3].T, -away[:, None])  # (1,) each
    if ahead[0] * ahead[0] + left[0] * left[0] <= (OVERHEAD * center[2]) ** 2:  # no direction: rounding would decide
        ahead, left, _ = product(world_from_vehicle[:3, :3].T, world_from_camera[:3, 1, None])
    distance = math.sqrt(center[0] * center[0] + center[1] * center[1] + center[2] * center[2])
    box = Box3D(*((np.round(values, DIGITS) + 0.0).tolist() for values in (center, high - low, rotation)))  # no -0.0
    return Fields(round(distance, DIGITS), round(float(arctan2(left, ahead)[0]), DIGITS), box)


def check_space(space: Fields) -> Iterator[str]:
    """Find problems of a label's ``bbox_3d`` and ``distance``."""
    if (box := space.bbox_3d) is None:
        return
    center, size, rotation = (np.array(values) for values in (box.center, box.size, box.rotation))
    if not (size > 0.0).all():
        yield f"bbox_3d has the size {size.tolist()}"
    elif not np.abs(rotation @ rotation.T - np.eye(3)).max() <= TOLERANCE or not np.linalg.det(rotation) > 0.0:
        yield "bbox_3d has a rotation that is none"
    else:
        far, stated = float(np.linalg.norm(center)), space.distance
        if stated is not None and not abs(stated - far) <= TOLERANCE * max(1.0, far):
            yield f"distance is {stated}, bbox_3d is {far:.9g} m away"


def _problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    return check_space(BOX_3D.read(label))


BOX_3D = LabelType(Fields, _problems, of_row=space_of)
