"""The corners of a label's 3D box in the image."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct

from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import NEAR, project_camera
from hulldown.dataset.images import Category, Image, Label
from hulldown.dataset.labels.box_3d import BOX_3D, Box3D, space_of
from hulldown.dataset.labels.label_type import LabelType
from hulldown.dataset.store.declared import Pixel
from hulldown.geometry.transforms import product
from hulldown.planning.plan.row import PlannedVehicle, Row

DIGITS = 6  # of pixels
FAR = 1e9  # pixels: limit of what a record can have
TOLERANCE = 1e-5  # pixels: more than they're rounded by
# In halves of the box's size: front left, front right, rear right, rear left, of the lower side, then of the upper one.
_CORNERS = np.array([[x, y, z] for z in (-0.5, 0.5) for x, y in ((0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5))])

Corner = tuple[Pixel, Pixel] | None


class Fields(Struct):
    """Eight corners in pixels, inside the image or not; null: nearer than the near plane."""

    bbox_3d_corners: Annotated[list[Corner], Meta(min_length=8, max_length=8)] | None = None


def box_corners(box: Box3D, intrinsics: Intrinsics) -> Float[np.ndarray, "8 2"]:
    """Return the corners of a `bbox_3d` in pixels; nan where one isn't in front of the near plane."""
    from_center = product(np.array(box.rotation), (_CORNERS * box.size).T).T
    pixels, depth = project_camera(intrinsics, np.array(box.center) + from_center)
    return np.where((depth >= NEAR)[:, None], np.clip(pixels, -FAR, FAR), np.nan)


def _of_row(vehicle: PlannedVehicle, row: Row) -> Fields:
    box = space_of(vehicle, row).bbox_3d
    assert box is not None
    corners = np.round(box_corners(box, row.intrinsics), DIGITS) + 0.0  # no -0.0
    return Fields([None if np.isnan(x) or np.isnan(y) else (x, y) for x, y in corners.tolist()])


def _problems(label: Label, image: Image, category: Category | None) -> Iterator[str]:
    """Find corners that aren't those of the 3D box in the image's camera."""
    given, box, intrinsics = CORNERS.read(label).bbox_3d_corners, BOX_3D.read(label).bbox_3d, image.intrinsics
    if given is None or box is None or intrinsics is None:
        return
    wanted = box_corners(box, intrinsics)
    corners = np.array([corner or (np.nan, np.nan) for corner in given])
    if not np.allclose(corners, wanted, rtol=1e-9, atol=TOLERANCE, equal_nan=True):
        yield "bbox_3d_corners aren't the corners of bbox_3d"


CORNERS = LabelType(Fields, _problems, of_row=_of_row)
