"""Reasons for rejecting a place or a camera, and how often each one occurs."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Int, UInt8

from hulldown.placement.clearance import CameraRejection
from hulldown.placement.settle import PlaceRejection


class Rejection(IntEnum):
    """Reasons of rejection, each with a phrase that completes "of 100 tries 3 % ..."; 0 is an accepted try.

    Those of a place come first, in the order of the checks, then those of a camera, then later additions.
    Codes and names are in plan files and never change.
    """

    phrase: str

    def __new__(cls, code: int, phrase: str) -> Rejection:
        """Return a code with its phrase."""
        member = int.__new__(cls, code)
        member._value_ = int(code)
        member.phrase = phrase
        return member

    NONE = PlaceRejection.NONE, "were taken"
    OFF_GROUND = PlaceRejection.OFF_GROUND, "had no ground below"
    TOO_STEEP = PlaceRejection.TOO_STEEP, "were too steep at the spot"
    OVERHANG = PlaceRejection.OVERHANG, "hung over an edge or a hole"
    MEAN_TOO_STEEP = PlaceRejection.MEAN_TOO_STEEP, "were too steep under the whole footprint"
    GAP = PlaceRejection.GAP, "left too wide a gap under the vehicle"
    PENETRATION = PlaceRejection.PENETRATION, "sank too deep into the ground"
    OBSTACLE = 7, "were too near an obstacle"
    VEHICLE = 8, "were too near another vehicle"
    COMPANION = 9, "had no room for the other vehicles"
    NO_VIEW = 10, "could not be seen by any camera"
    DISTANCE = 11, "needed a camera outside camera.distance_m"
    CAMERA_OFF_GROUND = CameraRejection.OFF_GROUND, "had the camera beyond the ground"
    CAMERA_LOW = CameraRejection.LOW, "had the camera in or too near the ground"
    CAMERA_OBSTACLE = CameraRejection.OBSTACLE, "had the camera in or too near an obstacle"
    CAMERA_VEHICLE = CameraRejection.VEHICLE, "had the camera in or too near a vehicle"
    TRUNCATION = 16, "were cut off more or less than camera.truncated_fraction"
    SMALL = 17, "were smaller than camera.min_box_px"
    HIDDEN = 18, "were hidden more than camera.visible_fraction"
    EXPOSED = 19, "were hidden less than camera.visible_fraction"
    SIZE = 20, "could have the wanted size at no distance"
    WATER = 21, "stood deeper in water than placement.fording_depth"
    DARK = 22, "were shut in, with no sky above"
    CAMERA_WATER = CameraRejection.WATER, "had the camera in, below or too near water"
    FAINT = 24, "kept less contrast through the air than weather.min_contrast"

    @property
    def key(self) -> str:
        """The reason's name in `rejected` of a plan's rows."""
        return self.name.lower()


_PLACING_TOO = (Rejection.WATER, Rejection.DARK)
PLACE_REJECTIONS = tuple(r for r in Rejection if Rejection.NONE < r <= Rejection.NO_VIEW or r in _PLACING_TOO)
CAMERA_REJECTIONS = tuple(r for r in Rejection if r not in (Rejection.NONE, *PLACE_REJECTIONS))
REJECTION_KINDS = max(Rejection) + 1
BY_KEY = {r.key: r for r in Rejection}


def count_rejections_by_row(
    codes: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], rows: int
) -> Int[np.ndarray, "rows kinds"]:
    """Return how often each code occurs with each row."""
    return np.bincount(row * REJECTION_KINDS + codes, minlength=rows * REJECTION_KINDS).reshape(rows, REJECTION_KINDS)


def first_accepted_and_counts(
    rejection: UInt8[np.ndarray, "n t"], limit: Int[np.ndarray, " n"] | None = None
) -> tuple[Bool[np.ndarray, " n"], Int[np.ndarray, " q"], Int[np.ndarray, "n kinds"]]:
    """Return the first accepted of t tries in each row, of which the first `limit` count."""
    n, t = rejection.shape
    number, limits = np.arange(t), np.full(n, t) if limit is None else np.minimum(limit, t)
    good = (rejection == Rejection.NONE) & (number < limits[:, None])
    taken, first = good.any(axis=1), good.argmax(axis=1)
    row, column = np.nonzero(number < np.where(taken, first, limits)[:, None])
    counts = count_rejections_by_row(rejection[row, column].astype(np.int64), row, n)
    return taken, np.flatnonzero(taken) * t + first[taken], counts


def rejection_sentence(counts: Mapping[Rejection, int]) -> str:
    """Describe rejections of one kind, most frequent first: "of 10,000 tries 71 % were too steep, ..."."""
    total = sum(counts.values())
    present = sorted((r for r in counts if r and counts[r]), key=lambda r: (-counts[r], r))
    return f"of {total:,} tries " + ", ".join(f"{_format_percent(counts[r], total)} {r.phrase}" for r in present)


def _format_percent(part: int, total: int) -> str:
    share = 100 * part / total
    return f"{share:.0f} %" if share >= 1 else f"{share:.2g} %"
