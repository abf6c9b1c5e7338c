"""Reasons for rejecting a place or a camera, and how often each one occurs."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Int, UInt8


class Rejection(IntEnum):
    """Reasons, each with a phrase that completes "of 100 tries 3 % ..."; 0 is an accepted try.

    Those of a place come first, in the order of the checks, then those of a camera, then later additions.
    Codes and names are in plan files and never change.
    """

    phrase: str

    def __new__(cls, code: int, phrase: str) -> Rejection:
        """Return a code with its phrase."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.phrase = phrase
        return member

    NONE = 0, "were taken"
    OFF_GROUND = 1, "had no ground below"
    TOO_STEEP = 2, "were too steep at the spot"
    OVERHANG = 3, "hung over an edge or a hole"
    MEAN_TOO_STEEP = 4, "were too steep under the whole footprint"
    GAP = 5, "left too wide a gap under the vehicle"
    PENETRATION = 6, "sank too deep into the ground"
    OBSTACLE = 7, "were too near an obstacle"
    VEHICLE = 8, "were too near another vehicle"
    COMPANION = 9, "had no room for the other vehicles"
    NO_VIEW = 10, "could not be seen by any camera"
    DISTANCE = 11, "needed a camera outside camera.distance_m"
    CAMERA_OFF_GROUND = 12, "had the camera beyond the ground"
    CAMERA_LOW = 13, "had the camera in or too near the ground"
    CAMERA_OBSTACLE = 14, "had the camera in or too near an obstacle"
    CAMERA_VEHICLE = 15, "had the camera in or too near a vehicle"
    TRUNCATION = 16, "were cut off more or less than camera.truncated_fraction"
    SMALL = 17, "were smaller than camera.min_box_px"
    HIDDEN = 18, "were hidden more than camera.visible_fraction"
    EXPOSED = 19, "were hidden less than camera.visible_fraction"
    SIZE = 20, "could have the wanted size at no distance"
    WATER = 21, "stood deeper in water than placement.fording_depth"
    DARK = 22, "were shut in, with no sky above"
    CAMERA_WATER = 23, "had the camera in, below or too near water"
    FAINT = 24, "kept less contrast through the air than weather.min_contrast"

    @property
    def key(self) -> str:
        """The reason's name in `rejected` of a plan's rows."""
        return self.name.lower()


_PLACING_TOO = (Rejection.WATER, Rejection.DARK)
PLACING = tuple(r for r in Rejection if Rejection.NONE < r <= Rejection.NO_VIEW or r in _PLACING_TOO)
AIMING = tuple(r for r in Rejection if r not in (Rejection.NONE, *PLACING))
KINDS = max(Rejection) + 1
BY_KEY = {r.key: r for r in Rejection}


def count_rejections(
    codes: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], rows: int
) -> Int[np.ndarray, "rows kinds"]:
    """Return how often each code occurs with each row."""
    return np.bincount(row * KINDS + codes, minlength=rows * KINDS).reshape(rows, KINDS)


def first_accepted(
    rejection: UInt8[np.ndarray, "n t"], limit: Int[np.ndarray, " n"] | None = None
) -> tuple[Bool[np.ndarray, " n"], Int[np.ndarray, " q"], Int[np.ndarray, "n kinds"]]:
    """Find the first accepted of t tries in each row, of which the first `limit` count."""
    n, t = rejection.shape
    number, limits = np.arange(t), np.full(n, t) if limit is None else np.minimum(limit, t)
    good = (rejection == Rejection.NONE) & (number < limits[:, None])
    taken, first = good.any(axis=1), good.argmax(axis=1)
    row, column = np.nonzero(number < np.where(taken, first, limits)[:, None])
    counts = count_rejections(rejection[row, column].astype(np.int64), row, n)
    return taken, np.flatnonzero(taken) * t + first[taken], counts


def rejection_sentence(counts: Mapping[Rejection, int]) -> str:
    """Put rejections of one kind into words, most frequent first: "of 10,000 tries 71 % were too steep, ..."."""
    total = sum(counts.values())
    present = sorted((r for r in counts if r and counts[r]), key=lambda r: (-counts[r], r))
    return f"of {total:,} tries " + ", ".join(f"{_format_percent(counts[r], total)} {r.phrase}" for r in present)


def _format_percent(part: int, total: int) -> str:
    share = 100 * part / total
    return f"{share:.0f} %" if share >= 1 else f"{share:.2g} %"
