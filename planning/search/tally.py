"""Count rejected tries by reason, and put the counts into words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Int

from hulldown.placement.rejection import Rejection

_PLACING_TOO = (Rejection.WATER, Rejection.DARK)
PLACING = tuple(r for r in Rejection if Rejection.NONE < r <= Rejection.NO_VIEW or r in _PLACING_TOO)
AIMING = tuple(r for r in Rejection if r not in (Rejection.NONE, *PLACING))
KINDS = max(Rejection) + 1
BY_KEY = {r.key: r for r in Rejection}


def tally(codes: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], rows: int) -> Int[np.ndarray, "rows kinds"]:
    """Return how often each code occurs with each row."""
    return np.bincount(row * KINDS + codes, minlength=rows * KINDS).reshape(rows, KINDS)


def sentence(counts: Mapping[Rejection, int]) -> str:
    """Put rejections of one kind into words, most frequent first: "of 10,000 tries 71 % were too steep, ..."."""
    total = sum(counts.values())
    present = sorted((r for r in counts if r and counts[r]), key=lambda r: (-counts[r], r))
    return f"of {total:,} tries " + ", ".join(f"{_percent(counts[r], total)} {r.phrase}" for r in present)


def _percent(part: int, total: int) -> str:
    share = 100 * part / total
    return f"{share:.0f} %" if share >= 1 else f"{share:.2g} %"
