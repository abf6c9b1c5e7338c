"""Poses that users give, as a plan's header has them."""

from __future__ import annotations

from msgspec import Struct

MAX_COORDINATE_M = 1e9  # beyond, float64 is coarser than a tenth of a micrometer

Vector = tuple[float, float, float]


class PoseLine(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The values that a user gives of one image; what is None is planned."""

    line: int  # its number in the file
    scenery: str | None = None
    vehicle: str | None = None
    # x, y, z: the vehicle's origin, the center of its underside, in the coordinates of the scenery's file, meters
    x: float | None = None
    y: float | None = None
    z: float | None = None
    yaw_deg: float | None = None  # heading in degrees, counterclockwise from +x
    # camera, look_at: the camera's place, and a point on its optical axis, in the same coordinates
    camera: Vector | None = None
    look_at: Vector | None = None
    # name of a sequence: successive lines with the same vehicle in the same place, and moving cameras
    sequence: str | None = None


class GivenPoses(Struct, frozen=True, kw_only=True):
    """The name of a file of poses, and its lines."""

    path: str
    lines: list[PoseLine]
