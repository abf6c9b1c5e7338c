"""Coats of paint drawn from the config's colors.

Every vehicle of a position has its own coats, which all shots share. They depend only on seed, position, and the
vehicle's number in the row.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike

from hulldown.plan.coats import Coat
from hulldown.plan.config.asset_sections import OWN, PaintEntry
from hulldown.planning.search.random_streams import Purpose, RandomStreams

COMPANIONS, DISTRACTORS = 1, 65  # number in a row of the first of each; the target's is 0


def draw_coats(
    paint: Sequence[PaintEntry], draws: RandomStreams, *, position: Int[np.ndarray, " n"], place: ArrayLike
) -> list[list[Coat]]:
    """Draw the coats of a vehicle at n positions; `place` is `COMPANIONS` + k, `DISTRACTORS` + k, or 0, the target."""
    n, kinds = len(position), len(paint)
    if not kinds:
        return [[] for _ in range(n)]
    sizes = np.array([len(entry.colors) for entry in paint])
    drawn = draws.uniform(Purpose.PAINT, position, place, count=kinds).reshape(n, kinds)
    choices = np.minimum((drawn * sizes).astype(np.int64), sizes - 1).tolist()
    return [[_choose_coat(entry, choice) for entry, choice in zip(paint, row, strict=True)] for row in choices]


def _choose_coat(entry: PaintEntry, choice: int) -> Coat:
    color = entry.colors[choice]
    return Coat(list(entry.materials), None if color == OWN else color)
