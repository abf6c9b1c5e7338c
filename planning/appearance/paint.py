"""Coats of paint drawn from the config's colors.

Every vehicle of a position has its own coats, which all shots share. They depend only on seed, position, and the
vehicle's number in the row.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from hulldown.planning.config.paint_section import OWN, PaintEntry
from hulldown.planning.plan.coats import Coat
from hulldown.planning.search.random_streams import Purpose, RandomStreams, between

COMPANIONS, DISTRACTORS = 1, 65  # number in a row of the first of each; the target's is 0
_NUMBERS = 4  # drawn for each coat: color, hue, saturation, value


def draw_coats(
    paint: Sequence[PaintEntry], draws: RandomStreams, *, position: Int[np.ndarray, " n"], place: ArrayLike
) -> list[list[Coat]]:
    """Draw the coats of a vehicle at n positions.

    `place` is 0 for the target, `COMPANIONS` + k for companion k of the row, and `DISTRACTORS` + k for distractor k.
    """
    n, kinds = len(position), len(paint)
    if not kinds:
        return [[] for _ in range(n)]
    u = draws.uniform(Purpose.PAINT, position, place, count=_NUMBERS * kinds).reshape(n, kinds, _NUMBERS)
    columns = [_coats(entry, u[:, k]) for k, entry in enumerate(paint)]
    return [list(coats) for coats in zip(*columns, strict=True)]


def _coats(entry: PaintEntry, u: Float[np.ndarray, "n 4"]) -> list[Coat]:
    choice = np.minimum((u[:, 0] * len(entry.colors)).astype(np.int64), len(entry.colors) - 1).tolist()
    spreads = (entry.hue_deg, entry.saturation, entry.value)
    # Adding zero turns -0.0 into 0.0.
    hue, saturation, value = (
        (np.round(between(*spread, u[:, 1 + i]), 9) + 0.0).tolist() for i, spread in enumerate(spreads)
    )
    colors = [None if not entry.colors or entry.colors[c] == OWN else entry.colors[c] for c in choice]
    return [
        Coat(list(entry.materials), color, *shift)
        for color, shift in zip(colors, zip(hue, saturation, value, strict=True), strict=True)
    ]
