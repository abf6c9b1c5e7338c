"""Why a vehicle may not stand where it was tried, and how often each reason was met."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike


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
        """The reason in words that complete "of 100 tries 3 % ...", with what to change about it."""
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


def count(verdicts: ArrayLike) -> dict[Verdict, int]:
    """How often each verdict occurs in an array of codes; verdicts that do not occur are left out."""
    codes, times = np.unique(np.asarray(verdicts, dtype=np.uint8), return_counts=True)
    return {Verdict(int(code)): int(n) for code, n in zip(codes, times, strict=True)}


def describe(counts: Mapping[Verdict, int]) -> str:
    """One sentence, most frequent refusal first: "of 10,000 tries 71 % were too steep at the spot, ...".

    Parameters
    ----------
    counts
        As `count` gives them, or sums of such counts.
    """
    total = sum(counts.values())
    if not total:
        return "nothing was tried"
    refused = sorted((v for v in counts if v is not Verdict.OK and counts[v]), key=lambda v: (-counts[v], v))
    parts = [f"{_percent(counts[v], total)} {v.phrase}" for v in refused]
    parts.append(f"{_percent(counts.get(Verdict.OK, 0), total)} {Verdict.OK.phrase}")
    return f"of {total:,} {'try' if total == 1 else 'tries'} " + ", ".join(parts)


def _percent(part: int, total: int) -> str:
    # 0 % and 100 % are said only where they are exact.
    if 0 < part < total:
        return f"{min(max(100 * part / total, 0.1), 99.9):.{0 if 1 <= 100 * part / total <= 99 else 1}f} %"
    return f"{100 * part // total} %"
