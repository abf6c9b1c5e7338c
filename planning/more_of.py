"""Which images a detector needs more of: from what it missed, by bin, to weights of planned images.

A plan that learns from misses draws several candidates for most positions, each of which meets the config's limits,
and takes one in proportion to the weights of its labels.
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
CANDIDATES = 8  # for each other position; no bin's share grows by more than this
MOST = 4.0  # highest weight of a bin, and the inverse of the lowest
NORMAL = 1.96  # deviations of a normal distribution within a 95 % interval
NAMED = ("vehicle", "weather", "scenery", "hdri")
# Pixels aren't known to a plan, nor is `class` its choice: the budget's.
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
    """The weights of bins by field, from the report of an evaluation.

    A bin's weight is the share of its labels that were missed, relative to that of all labels. The difference counts
    as far as it is larger than its standard error (James and Stein's positive part), so that a bin of few labels
    weighs 1. Weights are rounded, and bins that weigh 1 are left out.

    Raises
    ------
    ConfigError
        If it's no report of one detector, or no bin that a plan decides differs from the others by more than chance.
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
        field: found
        for field in PLANNED
        if (found := {one.bin: w for one in report.bins.get(field, ()) if (w := _weight(one, missed)) != 1.0})
    }
    if not weights:
        remedy = "evaluate on more photographs; of theirs only box sizes are known, of renders all"
        raise ConfigError("no bin differs significantly from the others", path=path, remedy=remedy)
    return MoreOf(weights=weights, picture_px=report.picture_px)


def _weight(one: _Bin, missed: float) -> float:
    low, high = one.recall_interval
    if one.recall is None or low is None or high is None:
        return 1.0
    excess, error = (1.0 - one.recall) - missed, (high - low) / (2.0 * NORMAL)
    certain = max(0.0, 1.0 - (error / excess) ** 2) if excess else 0.0
    return round(min(max(1.0 + certain * excess / missed, 1.0 / MOST), MOST), 3)


def position_weights(rows: Sequence[Row], more_of: MoreOf) -> dict[int, float]:
    """The weight of each position of some rows: the mean over its images' labels; 1 without labels.

    A label's is the highest of its bins times the lowest: bins of different fields are often the same labels, such as
    small and far, so that a product of all would count them twice.
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
    found = [np.ones(len(labels))]
    for field, of_bin in more_of.weights.items():
        if field in names:
            found.append(np.array([of_bin.get(name or "", 1.0) for name in names[field]]))
        else:
            found.append(_of_bins(field, numbers, of_bin))
    table = np.array(found)
    label = table.max(axis=0) * table.min(axis=0)
    totals: dict[int, list[float]] = {row.position: [] for row in rows}
    for i, weight in zip(of_row.tolist(), label.tolist(), strict=True):
        totals[rows[i].position].append(weight)
    return {position: float(np.mean(each)) if each else 1.0 for position, each in totals.items()}


def _of_bins(
    field: str, numbers: Mapping[str, Float[np.ndarray, " n"]], of_bin: Mapping[str, float]
) -> Float[np.ndarray, " n"]:
    if field == "azimuth_seen":
        return _looked_up(SIDES, sides_of(numbers["azimuth"]), of_bin)
    scale = next(scale for scale in (SIZE, *SCALES) if scale.name == field)
    return _looked_up(scale.bins, bins_of(numbers[field], scale), of_bin)


def _looked_up(
    names: Sequence[str], index: Int[np.ndarray, " n"], of_bin: Mapping[str, float]
) -> Float[np.ndarray, " n"]:
    return np.array([*(of_bin.get(name, 1.0) for name in names), 1.0])[index]  # -1 is unknown


def kept(ordinal: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Whether these positions of a vehicle keep the configured distribution: spread evenly, at least `KEPT` of them."""
    return np.ceil(KEPT * (ordinal + 1) - 1e-9) > np.ceil(KEPT * ordinal - 1e-9)
