"""What is known about labels, such as size, distance or weather, and bins of it that are the same for every dataset."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from training.labels import Labels
from training.predictions import Predictions

INFINITY = math.inf
MOST_NAMES = 30  # bins of a field of names, the most frequent; the others share one
Records = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, eq=False, slots=True)
class Field:
    """Bins of one thing that is known about labels.

    Parameters
    ----------
    name, title
        What it is called in files, and for readers.
    bins
        b names, in their order.
    of_label
        (g,) the bin of each label; -1 where it is not known.
    of_detection
        (d,) the same of detections, where it does not take a label to know it; else None: precision is not defined.
    """

    name: str
    title: str
    bins: tuple[str, ...]
    of_label: Int[np.ndarray, " g"]
    of_detection: Int[np.ndarray, " d"] | None


@dataclass(frozen=True, slots=True)
class _Scale:
    """A number that may be known of labels: what it is called, edges of its bins, and the bins' names."""

    name: str
    title: str
    edges: tuple[float, ...]
    bins: tuple[str, ...]


def _ranges(unit: str, *edges: float) -> tuple[str, ...]:
    """Names of bins between edges, the first and the last of which are open."""
    inner = [f"{low:g} to {high:g}{unit}" for low, high in itertools.pairwise(edges[1:-1])]
    return f"under {edges[1]:g}{unit}", *inner, f"{edges[-2]:g}{unit} and more"


def _scale(name: str, title: str, unit: str, *edges: float, bins: tuple[str, ...] = ()) -> _Scale:
    return _Scale(name, title, edges, bins or _ranges(unit, *edges))


SIZE = _scale("box_size", "box size (root of its area)", " px", 0.0, 16.0, 32.0, 64.0, 96.0, 192.0, 384.0, INFINITY)
SCALES = (
    _scale("distance", "distance", " m", 0.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, INFINITY),
    _scale(
        "visible_fraction", "visible fraction", "", -INFINITY, 0.25, 0.5, 0.75, 0.9, 1.0, INFINITY,
        bins=("under 25 %", "25 to 50 %", "50 to 75 %", "75 to 90 %", "90 to 100 %", "100 %"),
    ),
    _scale(
        "truncated_fraction", "fraction outside the picture", "", -INFINITY, 1e-9, 0.1, 0.25, 0.5, INFINITY,
        bins=("0 %", "under 10 %", "10 to 25 %", "25 to 50 %", "50 % and more"),
    ),
    _scale("elevation", "camera elevation", "°", -INFINITY, 0.0, 5.0, 10.0, 20.0, 30.0, 45.0, INFINITY),
    _scale("slope", "slope", "°", 0.0, 5.0, 10.0, 15.0, 20.0, 25.0, INFINITY),
    _scale("contrast", "contrast", "", 0.0, 0.05, 0.1, 0.2, 0.4, INFINITY),
)  # fmt: skip


def fields(labels: Labels, predictions: Predictions) -> list[Field]:
    """Everything that labels can be put into bins by; what no label knows is left out, as are empty bins.

    What is stored comes first; distance, elevation, side and slope are else derived from stored poses.
    """
    numbers = _numbers_of(labels)
    found = [
        Field("class", "class", predictions.class_names, np.where(labels.crowd, -1, labels.label), predictions.label),
        Field(
            SIZE.name,
            SIZE.title,
            SIZE.bins,
            _digits(_side_length(labels), SIZE),
            _digits(_side_length(predictions), SIZE),
        ),
    ]
    found += [Field(one.name, one.title, one.bins, _digits(numbers[one.name], one), None) for one in SCALES]
    # Front within 45 degrees of straight ahead, rear within 45 of straight behind.
    turned = np.abs(numbers["azimuth"])
    sides = np.select([turned <= 45.0, turned < 135.0, turned <= 180.0], [0, 1, 2], -1)
    found.append(Field("azimuth_seen", "side seen", ("front", "side", "rear"), sides, None))
    found.append(_named("vehicle", "vehicle", [_text(box.get("vehicle")) for box in labels.annotations], None))
    for key, title, of in (("weather", "weather", _weather), ("scenery", "scenery", _text), ("hdri", "HDRI", _text)):
        values = [of(image.get(key)) if key in image else None for image in labels.images]
        names = [values[i] for i in labels.image.tolist()]
        found.append(_named(key, title, names, [values[i] for i in predictions.image.tolist()]))
    return [_without_empty(field) for field in found if (np.where(labels.crowd, -1, field.of_label) >= 0).any()]


def seen_from(
    world_from_vehicle: Float[np.ndarray, "n 4 4"], world_from_camera: Float[np.ndarray, "n 4 4"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Distance in metres, elevation and azimuth in degrees at which cameras stand, seen from targets.

    From the target's origin, the centre of its underside: where its centre is, records do not say. Azimuth is 0 in
    front of the target and positive to its left; elevation is above the horizon.
    """
    towards = world_from_camera[:, :3, 3] - world_from_vehicle[:, :3, 3]
    distance = np.linalg.norm(towards, axis=1)
    forward, left = (np.einsum("ni,ni->n", towards, world_from_vehicle[:, :3, axis]) for axis in (0, 1))
    elevation = np.degrees(np.arctan2(towards[:, 2], np.hypot(towards[:, 0], towards[:, 1])))
    return distance, elevation, np.degrees(np.arctan2(left, forward))


def _numbers_of(labels: Labels) -> dict[str, Float[np.ndarray, " g"]]:
    """Every number that is known of labels, nan where it is not."""
    vehicles = _poses(labels.annotations, "world_from_vehicle")
    cameras = _poses(labels.images, "world_from_camera")[labels.image]
    distance, elevation, azimuth = seen_from(vehicles, cameras)
    length = np.linalg.norm(vehicles[:, :3, 2], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = np.degrees(np.arccos(np.clip(vehicles[:, 2, 2] / length, -1.0, 1.0)))
    stored = {
        key: np.array([_number(box.get(key)) for box in labels.annotations], dtype=np.float64)
        for key in ("distance", "slope_deg", "visible_fraction", "truncated_fraction", "contrast")
    }
    return {
        **stored,
        "distance": np.where(np.isnan(stored["distance"]), distance, stored["distance"]),
        "slope": np.where(np.isnan(stored["slope_deg"]), slope, stored["slope_deg"]),
        "elevation": elevation,
        "azimuth": azimuth,
    }


def _poses(records: Records, key: str) -> Float[np.ndarray, "n 4 4"]:
    """(n, 4, 4) poses of records; nan where there is none."""
    poses = np.full((len(records), 4, 4), np.nan)
    known = [i for i, record in enumerate(records) if isinstance(record.get(key), list)]
    try:
        found = np.array([records[i][key] for i in known], dtype=np.float64).reshape(len(known), 4, 4)
    except (TypeError, ValueError):  # one at least is of another kind: it is left out
        for i in known:
            try:
                poses[i] = np.array(records[i][key], dtype=np.float64).reshape(4, 4)
            except (TypeError, ValueError):
                continue
    else:
        poses[known] = found
    return poses


def _side_length(boxes: Labels | Predictions) -> Float[np.ndarray, " n"]:
    return np.sqrt(np.abs(boxes.xywh[:, 2] * boxes.xywh[:, 3]))


def _weather(value: Any) -> str | None:
    """Bins of what a row says about weather: null is clear."""
    if value is None:
        return "clear"
    if isinstance(value, str):
        return value
    if not isinstance(value, Mapping):
        return None
    kind = value.get("kind") or value.get("type")
    metres = _number(value.get("visibility_m"))
    if math.isnan(metres):
        return str(kind) if kind else None
    return f"{kind or 'fog'}, " + ("under 500 m" if metres < 500 else "500 m to 2 km" if metres < 2000 else "over 2 km")


def _digits(values: Float[np.ndarray, " n"], scale: _Scale) -> Int[np.ndarray, " n"]:
    """The bin of each value, lower edges included; -1 for nan and what lies below all."""
    bins = np.searchsorted(np.array(scale.edges), values, side="right") - 1
    return np.where(np.isnan(values) | (bins >= len(scale.edges) - 1), -1, bins)


def _named(
    name: str,
    title: str,
    of_label: Sequence[str | None],
    of_detection: Sequence[str | None] | None,
    *,
    order: Sequence[str] | None = None,
) -> Field:
    """Bins by name; those beyond the thirty most frequent share one."""
    known = [one for one in of_label if one is not None]
    names = sorted(set(known) | {one for one in of_detection or () if one is not None})
    if order is not None:
        names = [one for one in order if one in names]
    elif len(names) > MOST_NAMES:
        counts = Counter(known)
        kept = sorted(sorted(names, key=lambda one: -counts[one])[:MOST_NAMES])
        names = [*kept, f"{len(names) - MOST_NAMES} others"]
    index: dict[str, int] = {one: i for i, one in enumerate(names)}

    def numbers(values: Sequence[str | None]) -> Int[np.ndarray, " n"]:
        return np.array([-1 if one is None else index.get(one, len(names) - 1) for one in values], dtype=np.int64)

    return Field(name, title, tuple(names), numbers(of_label), None if of_detection is None else numbers(of_detection))


def _without_empty(field: Field) -> Field:
    used = [field.of_label] if field.of_detection is None else [field.of_label, field.of_detection]
    there = np.bincount(np.concatenate([one[one >= 0] for one in used]), minlength=len(field.bins)) > 0
    new = np.append(np.cumsum(there) - 1, -1)
    return Field(
        field.name,
        field.title,
        tuple(name for name, kept in zip(field.bins, there, strict=True) if kept),
        new[field.of_label],
        None if field.of_detection is None else new[field.of_detection],
    )


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value else None


def _number(value: Any) -> float:
    return float(value) if type(value) in (int, float) and math.isfinite(value) else math.nan
