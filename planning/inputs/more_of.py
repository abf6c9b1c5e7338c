"""Weights of planned images, from the bins of labels that a detector missed.

With weights, a plan samples several candidates within the config's limits for most positions, and takes one of them in
proportion to the weights of its labels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int
from msgspec import Struct

from hulldown.annotate.known import SCALES, SIDES, SIZE, bins_of, numbers_of, sides_of, weather_of
from hulldown.geometry.errors import ConfigError
from hulldown.geometry.files import open_regular
from hulldown.planning.row import MoreOf, Row

KEPT = 0.3  # share of each vehicle's positions that keep the configured distribution
CANDIDATES = 8  # for each other position; the largest factor on a bin's share
MOST = 4.0  # largest weight of a bin; the smallest is its inverse
NORMAL = 1.96  # half the width of a normal distribution's 95 % interval, in standard deviations
NAMED = ("vehicle", "weather", "scenery", "hdri")
# Fields that depend on pixels are unknown to a plan, and `class` is set by the budget.
PLANNED = (SIZE.name, *(scale.name for scale in SCALES if scale.name != "contrast"), "azimuth_seen", *NAMED)


class _Bin(Struct):
    bin: str
    recall: float | None
    recall_interval: tuple[float | None, float | None]


class _Overall(Struct):
    recall: float | None


class _Report(Struct):
    overall: _Overall
    picture_px: float
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
    try:
        with open_regular(path) as file:
            report = msgspec.json.decode(file.read(), type=_Report)
    except OSError as error:
        raise ConfigError(f"cannot be read ({error.strerror})", path=path, remedy="name a report.json") from None
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        remedy = "name the report.json that `hulldown evaluate` writes for one detector"
        raise ConfigError(f"isn't a report of an evaluation ({error})", path=path, remedy=remedy) from None
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


def position_weights(rows: Sequence[Row], more_of: MoreOf) -> dict[int, float]:
    """Return the weight of each position: the mean over its images' labels, or 1 without labels.

    A label's weight is the largest of its bins' weights times the smallest. Bins of different fields often hold the
    same labels, such as small and far ones, which a product of all weights would count twice.
    """
    labels = [(i, vehicle) for i, row in enumerate(rows) for vehicle in row.labeled]
    of_row = np.array([i for i, _ in labels], dtype=np.int64)
    images = [{"world_from_camera": row.world_from_camera.tolist()} for row in rows]
    records: list[dict[str, Any]] = [
        {
            "world_from_vehicle": vehicle.world_from_vehicle.tolist(),
            "visible_fraction": vehicle.visible_fraction,
            "truncated_fraction": vehicle.truncated_fraction,
            "air_contrast": vehicle.air_contrast,
        }
        for _, vehicle in labels
    ]
    numbers = numbers_of(records, images, of_row)
    boxes = np.array([vehicle.bbox[2:] if vehicle.bbox else (np.nan, np.nan) for _, vehicle in labels]).reshape(-1, 2)
    picture = np.sqrt([rows[i].width * rows[i].height for i in of_row], dtype=np.float64)
    numbers[SIZE.name] = np.sqrt(boxes.prod(axis=1)) * more_of.picture_px / picture
    names: dict[str, list[str | None]] = {
        "vehicle": [vehicle.vehicle for _, vehicle in labels],
        "weather": [weather_of(None if (air := rows[i].weather) is None else msgspec.to_builtins(air)) for i in of_row],
        "scenery": [rows[i].scenery for i in of_row],
        "hdri": [rows[i].hdri for i in of_row],
    }
    columns = [np.ones(len(labels))]
    for field, of_bin in more_of.weights.items():
        if field in names:
            columns.append(np.array([of_bin.get(name or "", 1.0) for name in names[field]]))
        else:
            columns.append(_of_bins(field, numbers, of_bin))
    table = np.array(columns)
    label = table.max(axis=0) * table.min(axis=0)
    totals: dict[int, list[float]] = {row.position: [] for row in rows}
    for i, weight in zip(of_row.tolist(), label.tolist(), strict=True):
        totals[rows[i].position].append(weight)
    return {position: float(np.mean(each)) if each else 1.0 for position, each in totals.items()}


def _of_bins(
    field: str, numbers: Mapping[str, Float[np.ndarray, " n"]], of_bin: Mapping[str, float]
) -> Float[np.ndarray, " n"]:
    names: Sequence[str] = SIDES
    if field == "azimuth_seen":
        index = sides_of(numbers["azimuth"])
    else:
        scale = next(scale for scale in (SIZE, *SCALES) if scale.name == field)
        names, index = scale.bins, bins_of(numbers[field], scale)
    return np.array([*(of_bin.get(name, 1.0) for name in names), 1.0])[index]  # -1 is unknown


def kept(ordinal: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Whether these positions keep the configured distribution: at least the share `KEPT`, evenly spread."""
    return np.ceil(KEPT * (ordinal + 1) - 1e-9) > np.ceil(KEPT * ordinal - 1e-9)
