"""Attributes of labels, such as size, distance, or weather, and their bins in reports.

Fields of records come first; distance, elevation, side, and slope otherwise follow from poses.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from hulldown.camera.shell import shell_place

INFINITY = math.inf
SIDES = ("front", "side", "rear")
Records = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class Scale:
    """A numeric attribute of labels: title, unit, bin edges, and bin names."""

    name: str
    title: str
    unit: str
    edges: tuple[float, ...]
    bins: tuple[str, ...]


def _ranges(unit: str, *edges: float) -> tuple[str, ...]:
    """Return names of bins between edges, the first and the last of which are open."""
    inner = [f"{low:g} to {high:g}{unit}" for low, high in itertools.pairwise(edges[1:-1])]
    return f"under {edges[1]:g}{unit}", *inner, f"{edges[-2]:g}{unit} and more"


def _scale(name: str, title: str, unit: str, *edges: float, bins: tuple[str, ...] = ()) -> Scale:
    return Scale(name, title, unit.strip(), edges, bins or _ranges(unit, *edges))


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
    _scale(
        "air_contrast", "contrast after haze", "", -INFINITY, 0.05, 0.2, 0.5, 0.8, 1.0, INFINITY,
        bins=("under 5 %", "5 to 20 %", "20 to 50 %", "50 to 80 %", "80 to 100 %", "100 %"),
    ),
    _scale("contrast", "contrast", "", 0.0, 0.05, 0.1, 0.2, 0.4, INFINITY),
)  # fmt: skip


def numbers_of(labels: Records, images: Records, image: Int[np.ndarray, " g"]) -> dict[str, Float[np.ndarray, " g"]]:
    """Return the numbers of `SCALES` and ``azimuth`` for labels; nan if unknown.

    Parameters
    ----------
    labels, images
        COCO annotation and image records.
    image
        (g,) which of the images each label belongs to.
    """
    vehicles = poses_of(labels, "world_from_vehicle")
    cameras = poses_of(images, "world_from_camera")[image]
    distance, elevation, azimuth = seen_from(centers_of(labels, vehicles, cameras), vehicles, cameras)
    length = np.linalg.norm(vehicles[:, :3, 2], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = np.degrees(np.arccos(np.clip(vehicles[:, 2, 2] / length, -1.0, 1.0)))
    stored = {
        key: np.array([number(box.get(key)) for box in labels], dtype=np.float64)
        for key in ("distance", "slope_deg", "visible_fraction", "truncated_fraction", "air_contrast", "contrast")
    }
    return {
        **stored,
        "distance": np.where(np.isnan(stored["distance"]), distance, stored["distance"]),
        "slope": np.where(np.isnan(stored["slope_deg"]), slope, stored["slope_deg"]),
        "elevation": elevation,
        "azimuth": azimuth,
    }


def centers_of(
    labels: Records, world_from_vehicle: Float[np.ndarray, "n 4 4"], world_from_camera: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "n 3"]:
    """Return the centers of labels' 3D boxes in the world; without a ``bbox_3d``, vehicles' origins."""
    centers = world_from_vehicle[:, :3, 3].copy()
    for i, label in enumerate(labels):
        center = box.get("center") if isinstance(box := label.get("bbox_3d"), Mapping) else None
        if isinstance(center, list) and len(center) == 3 and all(math.isfinite(number(x)) for x in center):
            centers[i] = world_from_camera[i, :3, :3] @ np.array(center) + world_from_camera[i, :3, 3]
    return centers


def seen_from(
    centers: Float[np.ndarray, "n 3"],
    world_from_vehicle: Float[np.ndarray, "n 4 4"],
    world_from_camera: Float[np.ndarray, "n 4 4"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return distance in meters, elevation, and azimuth in degrees of cameras, seen from the centers of targets.

    Azimuth is 0 in front of the target and positive to its left; elevation is above the horizon.
    """
    toward = world_from_camera[:, :3, 3] - centers
    distance, _, elevation = shell_place(toward)
    forward, left = (np.einsum("ni,ni->n", toward, world_from_vehicle[:, :3, axis]) for axis in (0, 1))
    return distance, np.degrees(elevation), np.degrees(np.arctan2(left, forward))


def sides_of(azimuth: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return which of `SIDES` is seen from azimuths in degrees; -1 for nan.

    Front is within 45 degrees of straight ahead, rear within 45 of straight behind.
    """
    turned = np.abs(azimuth)
    return np.select([turned <= 45.0, turned < 135.0, turned <= 180.0], [0, 1, 2], -1)


def bins_of(values: Float[np.ndarray, " n"], scale: Scale) -> Int[np.ndarray, " n"]:
    """Return the bin of each value, lower edges included; -1 for nan and what lies below all."""
    bins = np.searchsorted(np.array(scale.edges), values, side="right") - 1
    return np.where(np.isnan(values) | (bins >= len(scale.edges) - 1), -1, bins)


def weather_of(value: Any) -> str | None:
    """Bin names of a row's weather; null is clear."""
    if value is None:
        return "clear"
    if isinstance(value, str):
        return value
    if not isinstance(value, Mapping):
        return None
    kind = value.get("kind") or value.get("type")
    meters = number(value.get("visibility_m"))
    if math.isnan(meters):
        return str(kind) if kind else None
    return f"{kind or 'fog'}, " + ("under 500 m" if meters < 500 else "500 m to 2 km" if meters < 2000 else "over 2 km")


def poses_of(records: Records, key: str) -> Float[np.ndarray, "n 4 4"]:
    """Poses (n, 4, 4) of records; nan if there is none."""
    poses = np.full((len(records), 4, 4), np.nan)
    for i, record in enumerate(records):
        if isinstance(record.get(key), list):
            with contextlib.suppress(TypeError, ValueError):  # a pose of another kind
                poses[i] = np.array(record[key], dtype=np.float64).reshape(4, 4)
    return poses


def name_of(value: Any) -> str | None:
    """Return a name in a record; None if it isn't a string."""
    return value if isinstance(value, str) and value else None


def number(value: Any) -> float:
    """Return a number in a record; nan if it isn't one."""
    return float(value) if type(value) in (int, float) and math.isfinite(value) else math.nan
