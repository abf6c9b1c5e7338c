"""Reasons for which a place is no resting pose; codes never change, as `plan.rejection` has them in plan files."""

from __future__ import annotations

from enum import IntEnum


class PlaceRejection(IntEnum):
    """Reasons in the order of the checks; 0 is an accepted place."""

    NONE = 0
    OFF_GROUND = 1
    TOO_STEEP = 2
    OVERHANG = 3
    MEAN_TOO_STEEP = 4
    GAP = 5
    PENETRATION = 6
