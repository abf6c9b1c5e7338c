"""Why a position or a camera was not taken, in words, and how often each reason was met."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

import numpy as np
from jaxtyping import Int

from placement.verdict import Verdict


class Refusal(IntEnum):
    """Reasons; those of `placement.verdict.Verdict` keep their codes."""

    NONE = 0
    OFF_GROUND = Verdict.OFF_GROUND
    TOO_STEEP = Verdict.TOO_STEEP
    OVERHANG = Verdict.OVERHANG
    MEAN_TOO_STEEP = Verdict.MEAN_TOO_STEEP
    GAP = Verdict.GAP
    PENETRATION = Verdict.PENETRATION
    OBSTACLE = Verdict.OBSTACLE
    VEHICLE = Verdict.VEHICLE
    COMPANION = 9
    NO_VIEW = 10
    DISTANCE = 11
    CAMERA_OFF_GROUND = 12
    CAMERA_LOW = 13
    CAMERA_OBSTACLE = 14
    CAMERA_VEHICLE = 15
    TRUNCATION = 16
    SMALL = 17
    HIDDEN = 18
    EXPOSED = 19
    SIZE = 20

    @property
    def key(self) -> str:
        """The reason as the plan's rows write it."""
        return self.name.lower()

    @property
    def phrase(self) -> str:
        """The reason in words that complete "of 100 tries 3 % ..."."""
        return _PHRASES.get(self) or Verdict(int(self)).phrase


_PHRASES = {
    Refusal.COMPANION: "had no room for the other vehicles",
    Refusal.NO_VIEW: "could not be seen by any camera",
    Refusal.DISTANCE: "needed a camera outside camera.distance_m",
    Refusal.CAMERA_OFF_GROUND: "had the camera beyond the ground",
    Refusal.CAMERA_LOW: "had the camera in or too near the ground",
    Refusal.CAMERA_OBSTACLE: "had the camera in or too near an obstacle",
    Refusal.CAMERA_VEHICLE: "had the camera in or too near a vehicle",
    Refusal.TRUNCATION: "were cut off more or less than camera.truncated_fraction",
    Refusal.SIZE: "could have the wanted size at no distance",
    Refusal.SMALL: "were smaller than camera.min_box_px",
    Refusal.HIDDEN: "were hidden more than camera.visible_fraction",
    Refusal.EXPOSED: "were hidden less than camera.visible_fraction",
}
PLACING = tuple(r for r in Refusal if Refusal.NONE < r <= Refusal.NO_VIEW)
AIMING = tuple(r for r in Refusal if r > Refusal.NO_VIEW)
KINDS = max(Refusal) + 1
BY_KEY = {r.key: r for r in Refusal}


def tally(codes: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], rows: int) -> Int[np.ndarray, "rows kinds"]:
    """How often each code stands beside each row."""
    return np.bincount(row * KINDS + codes, minlength=rows * KINDS).reshape(rows, KINDS)


def sentence(counts: Mapping[Refusal, int]) -> str:
    """The refusals of one kind in words, most frequent first: "of 10,000 tries 71 % were too steep, ..."."""
    total = sum(counts.values())
    refused = sorted((r for r in counts if r and counts[r]), key=lambda r: (-counts[r], r))
    return f"of {total:,} tries " + ", ".join(f"{_percent(counts[r], total)} {r.phrase}" for r in refused)


def _percent(part: int, total: int) -> str:
    share = 100 * part / total
    return f"{share:.0f} %" if share >= 1 else f"{share:.2g} %"
