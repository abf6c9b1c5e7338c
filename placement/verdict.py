"""Why a vehicle may not stand where it was tried."""

from __future__ import annotations

from enum import IntEnum


class Verdict(IntEnum):
    """What became of a candidate; the reasons are in the order in which they are looked for."""

    OK = 0
    OFF_GROUND = 1
    TOO_STEEP = 2
    OVERHANG = 3
    MEAN_TOO_STEEP = 4
    GAP = 5
    PENETRATION = 6
    OBSTACLE = 7
    VEHICLE = 8

    @property
    def phrase(self) -> str:
        """The reason in words that complete "of 100 tries 3 % ..."."""
        return _PHRASES[self]


_PHRASES = {
    Verdict.OK: "were taken",
    Verdict.OFF_GROUND: "had no ground below",
    Verdict.TOO_STEEP: "were too steep at the spot",
    Verdict.OVERHANG: "hung over an edge or a hole",
    Verdict.MEAN_TOO_STEEP: "were too steep under the whole footprint",
    Verdict.GAP: "left too wide a gap under the vehicle",
    Verdict.PENETRATION: "sank too deep into the ground",
    Verdict.OBSTACLE: "were too near an obstacle",
    Verdict.VEHICLE: "were too near another vehicle",
}
