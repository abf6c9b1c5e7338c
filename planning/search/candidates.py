"""Weights of candidates for positions, by the bins in which a detector missed more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.annotate.attributes import SCALES, SIDES, SIZE, bins_of, numbers_of, sides_of, weather_of
from hulldown.planning.plan.bin_weights import MoreOf
from hulldown.planning.plan.row import Row

KEPT = 0.3  # share of each vehicle's positions that keep the configured distribution
CANDIDATES = 8  # for each other position; the largest factor on a bin's share


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
