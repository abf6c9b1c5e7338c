"""Attributes of labels, of records or by poses, such as size, distance, or weather, and their bins in reports."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from msgspec import UNSET, Struct, UnsetType

from hulldown.annotate.labels.box_3d import BoxInCamera
from hulldown.annotate.record_fields import LabelRecord, Pose, RenderedImageRecord, declared_fields
from hulldown.annotate.records import Image, Label
from hulldown.camera.shell import shell_coordinates

SEEN_SIDES = ("front", "side", "rear")


@dataclass(frozen=True, slots=True)
class Scale:
    """A numeric attribute of labels: title, unit, and lower edges and names of its bins, if evaluations have some."""

    name: str
    title: str
    unit: str = ""
    edges: tuple[float, ...] = ()
    bins: tuple[str, ...] = ()


def _scale_from_edges(name: str, title: str, unit: str, *edges: float) -> Scale:
    """Return a scale with a bin from 0 to the first edge, between any two edges, and from the last one on."""
    inner = [f"{low:g} to {high:g} {unit}" for low, high in itertools.pairwise(edges)]
    names = (f"under {edges[0]:g} {unit}", *inner, f"{edges[-1]:g} {unit} and more")
    return Scale(name, title, unit, (0.0, *edges), names)


BOX_SIZE_SCALE = _scale_from_edges("box_size", "box size (root of its area)", "px", 16.0, 32.0, 64.0, 96.0, 192.0, 384.0)
SCALES = (
    _scale_from_edges("distance", "distance", "m", 25.0, 50.0, 100.0, 200.0, 400.0, 800.0),
    Scale(
        "visible_fraction", "visible fraction", "", (-math.inf, 0.25, 0.5, 0.75, 0.9, 1.0),
        ("under 25 %", "25 to 50 %", "50 to 75 %", "75 to 90 %", "90 to 100 %", "100 %"),
    ),
    Scale("truncated_fraction", "fraction outside the picture"),
    Scale("elevation", "camera elevation", "°"),
    Scale("slope", "slope", "°"),
    Scale("air_contrast", "contrast after haze"),
)  # fmt: skip


def label_attribute_values(
    labels: Sequence[Label], images: Sequence[Image], image: Int[np.ndarray, " g"]
) -> dict[str, Float[np.ndarray, " g"]]:
    """Return the numbers of `SCALES` and ``azimuth`` for labels; nan if unknown."""
    fields = [label.read(LabelRecord) for label in labels]
    placed = [label.read(BoxInCamera) for label in labels]
    vehicles = pose_array([each.world_from_vehicle for each in fields])
    cameras = camera_poses(images)[image]
    # Centers of 3D boxes in the world; without one, vehicles' origins.
    boxed = np.array([each.bbox_3d is not None for each in placed], dtype=bool)
    in_camera = np.array([each.bbox_3d.center for each in placed if each.bbox_3d], dtype=np.float64).reshape(-1, 3)
    centers = vehicles[:, :3, 3].copy()
    centers[boxed] = (cameras[boxed, :3, :3] @ in_camera[..., None])[..., 0] + cameras[boxed, :3, 3]
    distance, elevation, azimuth = viewing_distance_and_angles(centers, vehicles, cameras)
    with np.errstate(invalid="ignore", divide="ignore"):
        upright = vehicles[:, 2, 2] / np.linalg.norm(vehicles[:, :3, 2], axis=1)
    stored = {
        key: np.array([getattr(each, key) for each in fields], dtype=np.float64)
        for key in ("visible_fraction", "truncated_fraction", "air_contrast")
    }
    stated = np.array([each.distance for each in placed], dtype=np.float64)
    return {
        **stored,
        "distance": np.where(np.isnan(stated), distance, stated),
        "slope": np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))),
        "elevation": elevation,
        "azimuth": azimuth,
    }


def viewing_distance_and_angles(
    centers: Float[np.ndarray, "n 3"],
    world_from_vehicle: Float[np.ndarray, "n 4 4"],
    world_from_camera: Float[np.ndarray, "n 4 4"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return distances in meters of cameras from targets' centers, elevation and azimuth (+: left) in degrees."""
    toward = world_from_camera[:, :3, 3] - centers
    distance, _, elevation = shell_coordinates(toward)
    forward, left = (np.einsum("ni,ni->n", toward, world_from_vehicle[:, :3, axis]) for axis in (0, 1))
    return distance, np.degrees(elevation), np.degrees(np.arctan2(left, forward))


def seen_side_indices(azimuth: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return which of `SEEN_SIDES`, 90 degrees each, is seen from azimuths in degrees; -1 for nan."""
    turned = np.abs(azimuth)
    return np.select([turned <= 45.0, turned < 135.0, turned <= 180.0], [0, 1, 2], -1)


def value_bin_indices(values: Float[np.ndarray, " n"], scale: Scale) -> Int[np.ndarray, " n"]:
    """Return the bin of each value, lower edges included; -1 for nan and values below all."""
    return np.where(np.isnan(values), -1, np.searchsorted(np.array(scale.edges), values, side="right") - 1)


class _Weather(Struct):
    """The weather of a row, or another tool's."""

    kind: str | None = None
    type: str | None = None
    visibility_m: float | None = None


class Conditions(RenderedImageRecord):
    """Fields of an image's record about its scenery, light, and air."""

    position: float | None = None
    strength: float | None = None
    weather: _Weather | str | UnsetType | None = UNSET

    @property
    def weather_bin_name(self) -> str:
        """Name of the weather's bin: "clear" for null, and empty if unknown."""
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


def image_conditions(images: Sequence[Image]) -> list[Conditions]:
    """Return the conditions of each image."""
    return [declared_fields(image.record, Conditions) for image in images]


def camera_poses(images: Sequence[Image]) -> Float[np.ndarray, "n 4 4"]:
    """Return the poses of images' cameras; nan if there is none."""
    return pose_array([declared_fields(image.record, RenderedImageRecord).world_from_camera for image in images])


def pose_array(given: Sequence[Pose | None]) -> Float[np.ndarray, "n 4 4"]:
    """Return poses as an array; nan if there is none."""
    none = np.full((4, 4), np.nan)
    return np.array([none if pose is None or len(pose) != 4 else pose for pose in given]).reshape(-1, 4, 4)
