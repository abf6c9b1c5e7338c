"""Weights of planned images, from the bins of labels that a detector missed.

With weights, a plan samples several candidates within the config's limits for most positions, and takes one of them in
proportion to the weights of its labels.
"""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from hulldown.annotate.attributes import SCALES, SIZE
from hulldown.base.errors import ConfigError
from hulldown.base.outside import read_json
from hulldown.planning.plan.bin_weights import MoreOf

MOST = 4.0  # largest weight of a bin; the smallest is its inverse
NORMAL = 1.96  # half the width of a normal distribution's 95 % interval, in standard deviations
NAMED = ("vehicle", "weather", "scenery", "hdri")
# Fields that depend on pixels are unknown to a plan, and `class` is set by the budget.
PLANNED = (SIZE.name, *(scale.name for scale in SCALES if scale.name != "contrast"), "azimuth_seen", *NAMED)


_Share = Annotated[float, Meta(ge=0, le=1)]
_Bound = Annotated[float, Meta(ge=-1, le=2)]  # of a normal approximation


class _Bin(Struct):
    bin: str
    recall: _Share | None
    recall_interval: tuple[_Bound | None, _Bound | None]


class _Overall(Struct):
    recall: _Share | None


class _Report(Struct):
    overall: _Overall
    picture_px: Annotated[float, Meta(ge=1, le=1e6)]
    bins: dict[str, list[_Bin]]


def read_more_of(path: Path) -> MoreOf:
    """Read the weights of bins by field from the report of an evaluation.

    A bin's weight is its miss rate relative to that of all labels. The difference is shrunk toward 0 by its standard
    error (James and Stein's positive part), so that a bin of few labels has the weight 1. Weights are rounded, and bins
    with the weight 1 are left out.

    Raises
    ------
    ConfigError
        If it isn't the report of one detector, or no bin that a plan can change differs significantly.
    """
    remedy = "name the report.json that `hulldown evaluate` writes for one detector"
    refuse = partial(ConfigError, path=path, remedy=remedy)
    report = read_json(path, _Report, refuse, what="a report of an evaluation")
    missed = 1.0 - (report.overall.recall if report.overall.recall is not None else math.nan)
    if not missed > 0.0:
        raise ConfigError("no label was missed", path=path, remedy="evaluate on harder photographs")
    weights = {
        field: of_bin
        for field in PLANNED
        if (of_bin := {b.bin: w for b in report.bins.get(field, ()) if (w := _weight(b, missed)) != 1.0})
    }
    if not weights:
        remedy = "evaluate on more photographs; of theirs only box sizes are known, of renders all"
        raise ConfigError("no bin differs significantly from the others", path=path, remedy=remedy)
    return MoreOf(weights=weights, picture_px=report.picture_px)


def _weight(of_bin: _Bin, missed: float) -> float:
    low, high = of_bin.recall_interval
    if of_bin.recall is None or low is None or high is None:
        return 1.0
    excess, error = (1.0 - of_bin.recall) - missed, (high - low) / (2.0 * NORMAL)
    certain = max(0.0, 1.0 - (error / excess) ** 2) if excess else 0.0
    return round(min(max(1.0 + certain * excess / missed, 1.0 / MOST), MOST), 3)
