import math

import numpy as np
import pytest

from hulldown.annotate.boxes import VehicleBoxes, truncated_fraction
from hulldown.assets.vehicle import VehicleShape
from hulldown.camera.cameras import Cameras
from hulldown.camera.intrinsics import Intrinsics
from hulldown.geometry.transforms import rigid_matrix
from hulldown.tests.builders.shapes import CORNERS, box, vehicle_of

CUBE = 2.0 * CORNERS - 1.0
# fov_x of 90 degrees: f_px is half the width.
INTRINSICS = Intrinsics(200, 100, math.pi / 2)


def camera_at(x: float, y: float, z: float, intrinsics: Intrinsics = INTRINSICS) -> Cameras:
    """A camera along +z of the world, with x right and y down."""
    return Cameras(intrinsics, rigid_matrix(np.eye(3), [x, y, z]))


def vehicle() -> VehicleShape:
    """A cube with a smaller cube on top that turns about z."""
    cubes = box((-1, -1, -1), (1, 1, 1)), box((0.5, -0.5, 1.0), (1.5, 0.5, 2.0))
    return vehicle_of(*cubes, name="cubes", pivots=[[0, 0, 0], [0, 0, 1]])


def test_a_batch_has_a_row_per_pose_and_nan_for_invisible_targets():
    boxes = VehicleBoxes(vehicle())
    cameras = Cameras(INTRINSICS, rigid_matrix(np.eye(3), [[0, 0, -8], [4, 0, -5], [0, 0, 5], [30, 0, -5]]))
    found = boxes.boxes(np.tile(np.eye(4), (4, 1, 1)), cameras)
    assert found.truncated_fraction[0] == 0.0
    assert 0.0 < found.truncated_fraction[1] < 1.0
    assert found.truncated_fraction[2:].tolist() == [1.0, 1.0]
    assert np.isnan(found.xywh).all(axis=1).tolist() == [False, False, True, True]
    assert np.isnan(found.amodal).all(axis=1).tolist() == [False, False, True, False]


@pytest.mark.parametrize(
    ("inner", "outer", "share"),
    [
        ([0, 0, 4, 2], [0, 0, 4, 2], 0.0),
        ([0, 0, np.nextafter(4, 5), 2], [0, 0, 4, 2], 0.0),
        ([0, 0, 4, 2], [-4, 0, 8, 2], 0.5),
        ([0, 0, 4, 2], [-4, -2, 8, 4], 0.75),
        ([np.nan] * 4, [0, 0, 4, 2], 1.0),
        ([np.nan] * 4, [np.nan] * 4, 1.0),
        ([0, 0, 4, 0], [0, 0, 4, 0], 0.0),
        ([0, 0, 4, 0], [-4, 0, 8, 0], 0.5),
        ([0, 0, 0, 0], [0, 0, 0, 0], 0.0),
    ],
)
def test_truncated_fraction(inner, outer, share):
    assert truncated_fraction(inner, outer) == share
