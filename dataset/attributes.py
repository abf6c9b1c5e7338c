"""Attributes of labels, such as size, distance, or weather, and their bins in reports.

Fields of records come first; distance, elevation, side, and slope otherwise follow from poses.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from msgspec import UNSET, Struct, UnsetType

from hulldown.camera.shell import shell_place
from hulldown.dataset.images import Image, Label
from hulldown.dataset.store.declared import Pose, View, fields_of

INFINITY = math.inf
SIDES = ("front", "side", "rear")


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


class _Numbers(Struct):
    """Fields of a label's record."""

    slope_deg: float | None = None
    air_contrast: float | None = None
    contrast: float | None = None


def numbers_of(
    labels: Sequence[Label], images: Sequence[Image], image: Int[np.ndarray, " g"]
) -> dict[str, Float[np.ndarray, " g"]]:
    """Return the numbers of `SCALES` and ``azimuth`` for labels; nan if unknown."""
    fields, spaces = [fields_of(label.record, _Numbers) for label in labels], [label.fields for label in labels]
    vehicles = poses([label.world_from_vehicle for label in labels])
    cameras = camera_poses(images)[image]
    # Centers of 3D boxes in the world; without one, vehicles' origins.
    boxed = np.array([space.bbox_3d is not None for space in spaces], dtype=bool)
    in_camera = np.array([space.bbox_3d.center for space in spaces if space.bbox_3d], dtype=np.float64).reshape(-1, 3)
    centers = vehicles[:, :3, 3].copy()
    centers[boxed] = (cameras[boxed, :3, :3] @ in_camera[..., None])[..., 0] + cameras[boxed, :3, 3]
    distance, elevation, azimuth = seen_from(centers, vehicles, cameras)
    length = np.linalg.norm(vehicles[:, :3, 2], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = np.degrees(np.arccos(np.clip(vehicles[:, 2, 2] / length, -1.0, 1.0)))
    stored_distance = np.array([space.distance for space in spaces], dtype=np.float64)
    stored = np.array([(x.slope_deg, x.air_contrast, x.contrast) for x in fields], dtype=np.float64)
    stored_slope, air_contrast, contrast = stored.reshape(-1, 3).T
    return {
        "visible_fraction": np.array([label.visible_fraction for label in labels], dtype=np.float64),
        "truncated_fraction": np.array([label.truncated_fraction for label in labels], dtype=np.float64),
        "air_contrast": air_contrast,
        "contrast": contrast,
        "distance": np.where(np.isnan(stored_distance), distance, stored_distance),
        "slope": np.where(np.isnan(stored_slope), slope, stored_slope),
        "elevation": elevation,
        "azimuth": azimuth,
    }


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


class _Weather(Struct):
    """A row's weather, or another tool's."""

    kind: str | None = None
    type: str | None = None
    visibility_m: float | None = None


class Conditions(View):
    """Fields of an image's record about its scenery, light, and air."""

    position: float | None = None
    strength: float | None = None
    weather: _Weather | str | UnsetType | None = UNSET

    @property
    def weather_name(self) -> str:
        """Name of the weather's bin; null is clear, and empty if it isn't known."""
        if isinstance(self.weather, UnsetType):
            return ""
        if self.weather is None:
            return "clear"
        if isinstance(self.weather, str):
            return self.weather
        kind, meters = self.weather.kind or self.weather.type, self.weather.visibility_m
        if meters is None:
            return kind or ""
        far = "under 500 m" if meters < 500 else "500 m to 2 km" if meters < 2000 else "over 2 km"
        return f"{kind or 'fog'}, {far}"


def conditions_of(images: Sequence[Image]) -> list[Conditions]:
    """Return the conditions of each image."""
    return [fields_of(image.record, Conditions) for image in images]


def camera_poses(images: Sequence[Image]) -> Float[np.ndarray, "n 4 4"]:
    """Return the poses of images' cameras; nan if there is none."""
    return poses([fields_of(image.record, View).world_from_camera for image in images])


def poses(given: Sequence[Pose | None]) -> Float[np.ndarray, "n 4 4"]:
    """Return poses as an array; nan if there is none."""
    none = np.full((4, 4), np.nan)
    return np.array([none if pose is None or len(pose) != 4 else pose for pose in given]).reshape(-1, 4, 4)
