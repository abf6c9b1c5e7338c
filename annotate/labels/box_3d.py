"""The 3D box of a label in its camera's frame, with its distance, the side that the camera sees, and its corners."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct

from hulldown.annotate.label_type import LabeledVehicle, LabelType
from hulldown.annotate.record_fields import Matrix3, Pixel, Vector3
from hulldown.annotate.records import Category, Image, Label
from hulldown.base.portable import arctan2
from hulldown.camera.cameras import NEAR_M
from hulldown.camera.intrinsics import Intrinsics
from hulldown.geometry.transforms import matrix_product

DECIMAL_DIGITS = 9  # rounded to a nanometer, so that every processor gives the same
VALUE_TOLERANCE = 1e-6
MIN_ZENITH_ANGLE_RADIANS = 1e-6  # a camera nearer to straight above has no azimuth
PIXEL_DIGITS = 6
MAX_RECORD_PX = 1e9
MAX_CORNER_ERROR_PX = 1e-5  # more than corners are rounded by
# In halves of the box's size: front left, front right, rear right, rear left, of the lower side, then of the upper one.
_UNIT_CORNERS = np.array([[x, y, z] for z in (-0.5, 0.5) for x, y in ((0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5))])


class Box3D(Struct):
    """An oriented box in the camera's frame."""

    center: Vector3
    size: Vector3
    rotation: Matrix3


class BoxInCamera(LabelType):
    """The 3D box, its corners in pixels, and where it is from the camera."""

    distance: Annotated[
        Annotated[float, Meta(ge=0, le=1e9)] | None, Meta(description="meters from the camera to the center of `bbox_3d`")
    ] = None
    azimuth_seen: Annotated[
        Annotated[float, Meta(ge=-10, le=10)] | None,
        Meta(
            description="radians from forward to the camera, counterclockwise from above; of a camera straight above, "
            "the direction of the image's lower edge"
        ),
    ] = None
    bbox_3d: Annotated[
        Box3D | None,
        Meta(
            description="oriented box in the camera's frame (x right, y down, z ahead): `center` in meters, `size` "
            "(length, width, height), `rotation` (3 x 3; columns: the vehicle's forward, left, up)"
        ),
    ] = None
    bbox_3d_corners: Annotated[
        Annotated[list[tuple[Pixel, Pixel] | None], Meta(min_length=8, max_length=8)] | None,
        Meta(
            description="its corners in the image, [x, y] in pixels: front left, front right, rear right, rear left of "
            "the lower side, then of the upper one; outside of the image too; `null`: less than 0.1 m ahead"
        ),
    ] = None

    @classmethod
    def compute_fields(cls, vehicle: LabeledVehicle) -> dict[str, object]:
        """Return position and box's corners in the camera's frame; those nearer than the near plane are None."""
        low, high = vehicle.bounds
        world_from_vehicle, world_from_camera = vehicle.world_from_vehicle, vehicle.camera.world_from_camera
        camera_from_world = world_from_camera[:3, :3].T
        rotation = matrix_product(camera_from_world, world_from_vehicle[:3, :3])
        middle = matrix_product(world_from_vehicle[:3, :3], ((low + high) / 2.0)[:, None])[:, 0] + world_from_vehicle[:3, 3]
        away = middle - world_from_camera[:3, 3]
        center = matrix_product(camera_from_world, away[:, None])[:, 0]
        ahead, left, _ = matrix_product(world_from_vehicle[:3, :3].T, -away[:, None])  # (1,) each
        if (
            ahead[0] * ahead[0] + left[0] * left[0] <= (MIN_ZENITH_ANGLE_RADIANS * center[2]) ** 2
        ):  # no direction: rounding would decide
            ahead, left, _ = matrix_product(world_from_vehicle[:3, :3].T, world_from_camera[:3, 1, None])
        distance = math.sqrt(center[0] * center[0] + center[1] * center[1] + center[2] * center[2])
        box = Box3D(
            *((np.round(values, DECIMAL_DIGITS) + 0.0).tolist() for values in (center, high - low, rotation))
        )  # no -0.0
        corners = np.round(box_3d_corner_pixels(box, vehicle.camera.lenses), PIXEL_DIGITS) + 0.0
        return {
            "distance": round(distance, DECIMAL_DIGITS),
            "azimuth_seen": round(float(arctan2(left, ahead)[0]), DECIMAL_DIGITS),
            "bbox_3d": {"center": box.center, "size": box.size, "rotation": box.rotation},
            "bbox_3d_corners": [None if np.isnan(corner).any() else corner.tolist() for corner in corners],
        }

    def problems(self, label: Label, image: Image, category: Category | None) -> Iterator[str]:
        """Find a box without size, an invalid rotation, a wrong distance, and corners that aren't the box's."""
        if (box := self.bbox_3d) is None:
            return
        center, size, rotation = (np.array(values) for values in (box.center, box.size, box.rotation))
        if not (size > 0.0).all():
            yield f"bbox_3d has the size {size.tolist()}"
        elif not np.abs(rotation @ rotation.T - np.eye(3)).max() <= VALUE_TOLERANCE or not np.linalg.det(rotation) > 0.0:
            yield "bbox_3d has a rotation that is none"
        else:
            far = float(np.linalg.norm(center))
            if self.distance is not None and not abs(self.distance - far) <= VALUE_TOLERANCE * max(1.0, far):
                yield f"distance is {self.distance}, bbox_3d is {far:.9g} m away"
        if self.bbox_3d_corners is None or image.intrinsics is None:
            return
        given = np.array([corner or (np.nan, np.nan) for corner in self.bbox_3d_corners])
        expected = box_3d_corner_pixels(box, image.intrinsics)
        if not np.allclose(given, expected, rtol=1e-9, atol=MAX_CORNER_ERROR_PX, equal_nan=True):
            yield "bbox_3d_corners aren't the corners of bbox_3d"


def box_3d_corner_pixels(box: Box3D, intrinsics: Intrinsics) -> Float[np.ndarray, "8 2"]:
    """Return the corners of a `bbox_3d` in pixels; nan where one isn't in front of the near plane."""
    from_center = matrix_product(np.array(box.rotation), (_UNIT_CORNERS * box.size).T).T
    pixels, depth = intrinsics.project_points(np.array(box.center) + from_center)
    return np.where((depth >= NEAR_M)[:, None], np.clip(pixels, -MAX_RECORD_PX, MAX_RECORD_PX), np.nan)
