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
from camera.target import Standing, VehicleTarget
from camera.visibility import Occluder
from dataset.planned import IMAGE_KEYS, LABEL_KEYS, labelled
from geometry.instances import InstancedScene
from geometry.rays import RayCaster


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
        self._occluders: tuple[str, list[Occluder]] = ("", [])  # of the scenery last asked for: rows come sorted

    def segmentations(self, row: Mapping[str, Any]) -> list[dict[str, Any]]:
        """`segmentation` (compressed run lengths) and `area` (pixels) of each labelled vehicle of a row."""
        camera = Camera(
            Intrinsics(row["width"], row["height"], math.radians(row["fov_x_deg"])), np.array(row["world_from_camera"])
        )
        standing = [(target, self._standing(target)) for target in targets(row)]
        occluders = self._hiding(row["scenery"])
        found = []
        for target in labelled(row):
            (vehicle,) = (mine for whose, mine in standing if whose is target)
            others = [other for whose, other in standing if whose is not target]
            mask = vehicle_mask(vehicle, camera, xywh=target["bbox"], occluders=occluders, others=others)
            found.append({"segmentation": encode(mask), "area": area(mask)})
        return found

    def _standing(self, target: Mapping[str, Any]) -> Standing:
        name = target["vehicle"]
        if name not in self._targets:
            self._targets[name] = VehicleTarget(self._vehicles[name])
        return Standing(self._targets[name], np.array(target["world_from_vehicle"])[None], target["articulation"])

    def _hiding(self, name: str) -> list[Occluder]:
        if self._occluders[0] != name:
            scenery = self._sceneries[name]
            found: list[Occluder] = [
                InstancedScene(scenery.obstacle_meshes, scenery.instance_mesh, scenery.world_from_instance)
            ]
            if scenery.ground is not None:
                found.append(RayCaster(scenery.ground))
            self._occluders = name, found
        return self._occluders[1]
