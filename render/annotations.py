"""From a plan's rows to COCO records; masks by Embree, which Cycles' own agree with to the pixel."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from annotate.masks import area, encode, vehicle_mask
from assets.scenery import Scenery
from assets.vehicle import VehicleShape
from camera.intrinsics import Intrinsics
from camera.projection import Camera
from camera.target import PosedVehicle, VehicleTarget
from camera.world import World
from dataset.planned import IMAGE_KEYS, LABEL_KEYS, labelled


def targets(row: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The vehicles of a row, the one it is about first."""
    return [row, *row["companions"]]


def image_record(row: Mapping[str, Any]) -> dict[str, Any]:
    """What `annotations.json` says about a row's image, but for id and file name."""
    return {key: row[key] for key in IMAGE_KEYS}


def annotation_records(row: Mapping[str, Any], segmentations: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What it says about each labelled vehicle of a row, but for the id."""
    return [
        {
            "category": target["category"],
            **{key: target[key] for key in LABEL_KEYS},
            **segmentation,
        }
        for target, segmentation in zip(labelled(row), segmentations, strict=True)
    ]


class Segmenter:
    """Visible masks of the vehicles of a plan's rows.

    Parameters
    ----------
    vehicles, sceneries
        By the names that the plan uses.
    """

    def __init__(self, vehicles: Mapping[str, VehicleShape], sceneries: Mapping[str, Scenery]) -> None:
        self._vehicles, self._sceneries = vehicles, sceneries
        self._targets: dict[str, VehicleTarget] = {}
        self._world: tuple[str, World] = ("", World())  # the scenery last asked for: rows come sorted

    def segmentations(self, row: Mapping[str, Any]) -> list[dict[str, Any]]:
        """`segmentation` (compressed run lengths) and `area` (pixels) of each labelled vehicle of a row."""
        camera = Camera(
            Intrinsics(row["width"], row["height"], math.radians(row["fov_x_deg"])), np.array(row["world_from_camera"])
        )
        posed = [(target, self._posed(target)) for target in targets(row)]
        scenery = self._scenery(row["scenery"])
        found = []
        for target in labelled(row):
            (vehicle,) = (mine for whose, mine in posed if whose is target)
            others = [other for whose, other in posed if whose is not target]
            mask = vehicle_mask(vehicle, camera, xywh=target["bbox"], world=scenery.with_vehicles(others))
            found.append({"segmentation": encode(mask), "area": area(mask)})
        return found

    def _posed(self, target: Mapping[str, Any]) -> PosedVehicle:
        name = target["vehicle"]
        if name not in self._targets:
            self._targets[name] = VehicleTarget(self._vehicles[name])
        return PosedVehicle(self._targets[name], np.array(target["world_from_vehicle"])[None], target["articulation"])

    def _scenery(self, name: str) -> World:
        if self._world[0] != name:
            self._world = name, World.of(self._sceneries[name])
        return self._world[1]
