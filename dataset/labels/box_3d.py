"""The 3D box of a label in its camera's frame, with its distance, the side that the camera sees, and its corners."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import NEAR_M, project_camera
from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.store.declared import Box3D
from hulldown.geometry.portable import arctan2
from hulldown.geometry.transforms import product
from hulldown.plan.row import PlannedVehicle, Row

DECIMAL_DIGITS = 9  # to a nanometer, so that every processor gives the same
VALUE_TOLERANCE = 1e-6
OVERHEAD_RADIANS = 1e-6  # radians from straight above, within which a camera has no azimuth
PIXEL_DIGITS = 6
PIXEL_LIMIT = 1e9  # what a record can have
PIXEL_TOLERANCE = 1e-5  # more than they're rounded by
# In halves of the box's size: front left, front right, rear right, rear left, of the lower side, then of the upper one.
_CORNERS = np.array([[x, y, z] for z in (-0.5, 0.5) for x, y in ((0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5))])


def position_in_camera(vehicle: PlannedVehicle, row: Row) -> dict[str, Any]:
    """Return a label's fields about the vehicle's position in the camera's frame, and its box's corners in pixels.

    Corners may be outside of the image; those nearer than the near plane are None.
    """
    low, high = np.array(vehicle.bounds.low), np.array(vehicle.bounds.high)
    world_from_vehicle, world_from_camera = vehicle.world_from_vehicle, row.world_from_camera
    camera_from_world = world_from_camera[:3, :3].T
    rotation = product(camera_from_world, world_from_vehicle[:3, :3])
    middle = product(world_from_vehicle[:3, :3], ((low + high) / 2.0)[:, None])[:, 0] + world_from_vehicle[:3, 3]
    away = middle - world_from_camera[:3, 3]
    center = product(camera_from_world, away[:, None])[:, 0]
    ahead, left, _ = product(world_from_vehicle[:3, :3].T, -away[:, None])  # (1,) each
    if (
        ahead[0] * ahead[0] + left[0] * left[0] <= (OVERHEAD_RADIANS * center[2]) ** 2
    ):  # no direction: rounding would decide
        ahead, left, _ = product(world_from_vehicle[:3, :3].T, world_from_camera[:3, 1, None])
    distance = math.sqrt(center[0] * center[0] + center[1] * center[1] + center[2] * center[2])
    box = Box3D(
        *((np.round(values, DECIMAL_DIGITS) + 0.0).tolist() for values in (center, high - low, rotation))
    )  # no -0.0
    corners = np.round(box_corners(box, row.intrinsics), PIXEL_DIGITS) + 0.0
    return {
        "distance": round(distance, DECIMAL_DIGITS),
        "azimuth_seen": round(float(arctan2(left, ahead)[0]), DECIMAL_DIGITS),
        "bbox_3d": {"center": box.center, "size": box.size, "rotation": box.rotation},
        "bbox_3d_corners": [None if np.isnan(corner).any() else corner.tolist() for corner in corners],
    }


def box_corners(box: Box3D, intrinsics: Intrinsics) -> Float[np.ndarray, "8 2"]:
    """Return the corners of a `bbox_3d` in pixels; nan where one isn't in front of the near plane."""
    from_center = product(np.array(box.rotation), (_CORNERS * box.size).T).T
    pixels, depth = project_camera(intrinsics, np.array(box.center) + from_center)
    return np.where((depth >= NEAR_M)[:, None], np.clip(pixels, -PIXEL_LIMIT, PIXEL_LIMIT), np.nan)


def box_3d_problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find a box without size, a rotation that is none, and another distance."""
    if (box := label.fields.bbox_3d) is None:
        return
    center, size, rotation = (np.array(values) for values in (box.center, box.size, box.rotation))
    if not (size > 0.0).all():
        yield f"bbox_3d has the size {size.tolist()}"
    elif not np.abs(rotation @ rotation.T - np.eye(3)).max() <= VALUE_TOLERANCE or not np.linalg.det(rotation) > 0.0:
        yield "bbox_3d has a rotation that is none"
    else:
        far, stated = float(np.linalg.norm(center)), label.fields.distance
        if stated is not None and not abs(stated - far) <= VALUE_TOLERANCE * max(1.0, far):
            yield f"distance is {stated}, bbox_3d is {far:.9g} m away"


def corner_problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find corners that aren't those of the 3D box in the image's camera."""
    given, box, intrinsics = label.fields.bbox_3d_corners, label.fields.bbox_3d, image.intrinsics
    if given is None or box is None or intrinsics is None:
        return
    corners = np.array([corner or (np.nan, np.nan) for corner in given])
    if not np.allclose(corners, box_corners(box, intrinsics), rtol=1e-9, atol=PIXEL_TOLERANCE, equal_nan=True):
        yield "bbox_3d_corners aren't the corners of bbox_3d"
