"""Oriented boxes of labels: around the visible mask, or of the ground under a vehicle, front first."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from jaxtyping import Float

from hulldown.annotate.rectangles import mask_rectangle, rectangle_corners
from hulldown.base.errors import DatasetError
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import NEAR, project_camera
from hulldown.dataset.space import check_space
from hulldown.dataset.store.entries import Record, is_list_of_numbers

# Of the lower side of bbox_3d, in halves of its size: front left, front right, rear right, rear left.
_GROUND = np.array([[0.5, 0.5, -0.5], [0.5, -0.5, -0.5], [-0.5, -0.5, -0.5], [-0.5, 0.5, -0.5]])


def visible_corners(label: Record, image: Record) -> Float[np.ndarray, "4 2"]:
    """Corners in pixels of a label's `obb`; without one, of its mask's rectangle; without a mask, of its box.

    Raises
    ------
    DatasetError
        If the mask is damaged.
    """
    if is_rectangle(given := label.get("obb")):
        return rectangle_corners(given)
    if label.get("segmentation"):
        try:
            rectangle = mask_rectangle(label["segmentation"], image["width"], image["height"])
        except ValueError as error:
            problem, path = f"annotation {label['id']}: {error}", Path(str(image["file_name"]))
            raise DatasetError(problem, path=path, remedy="check the dataset with `hulldown verify`") from None
        if rectangle is not None:
            return rectangle_corners(rectangle)
    x, y, w, h = label["bbox"]
    return rectangle_corners([x + w / 2, y + h / 2, w, h, 0.0])


def ground_corners(label: Record, image: Record) -> Float[np.ndarray, "4 2"]:
    """Pixels of the lower side of a label's `bbox_3d`: front left, front right, rear right, rear left.

    Raises
    ------
    DatasetError
        If box or camera aren't known, or a corner isn't in front of the camera.
    """
    where = f"annotation {label['id']}"
    remedy = "export boxes of what is visible, or delete the label"
    if label.get("bbox_3d") is None or any(check_space(label)):
        raise DatasetError(f"{where} has no bbox_3d", path=Path(str(image["file_name"])), remedy=remedy)
    box = label["bbox_3d"]
    corners = np.array(box["center"]) + (_GROUND * box["size"]) @ np.array(box["rotation"]).T
    try:
        pixels, depth = project_camera(Intrinsics.of_record(image), corners)
    except (KeyError, TypeError, ValueError):
        raise DatasetError("has no usable fov_x_deg or K", path=Path(str(image["file_name"])), remedy=remedy) from None
    if not (np.isfinite(pixels).all() and (depth >= NEAR).all()):
        raise DatasetError(f"{where}: its ground isn't all ahead", path=Path(str(image["file_name"])), remedy=remedy)
    return pixels


def is_rectangle(value: Any) -> TypeGuard[list[float]]:
    """Whether this is [center x, center y, width, height, angle], finite and with an area."""
    return is_list_of_numbers(value) and len(value) == 5 and bool(min(value[2:4]) > 0)
