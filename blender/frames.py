"""Conversion between hulldown's frames and Blender's: camera axes, and float64 matrices in float32."""

from __future__ import annotations

from typing import Any

import numpy as np

# OpenCV's camera looks along +z with y down, Blender's along -z with y up: a half turn about x.
CAMERA_FROM_BLENDER_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])


def world_from_blender_camera(world_from_camera: Any) -> np.ndarray:
    """Pose of Blender's camera object for an OpenCV camera pose (4, 4)."""
    return np.asarray(world_from_camera, dtype=np.float64) @ CAMERA_FROM_BLENDER_CAMERA


def set_object_pose(obj: Any, world_from_object: Any) -> None:
    """Give a Blender object the pose of a float64 affine matrix (4, 4).

    The matrix goes into the parent inverse, which Blender multiplies as it is; setting `matrix_world` would split it
    into location, Euler angles and scale, which rounds a rotation and loses shear. The object's parent must stand at
    the origin and its own location, rotation and scale must be those of a new object.
    """
    matrix = np.asarray(world_from_object, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"world_from_object: expected a finite (4, 4) matrix, got {matrix.tolist()}")
    obj.matrix_parent_inverse = matrix.T.tolist()  # Blender stores columns and takes nested lists as stored
