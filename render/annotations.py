"""From a plan's rows to COCO records; masks by Embree, which Cycles' own agree with to the pixel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from hulldown.annotate.masks import area, encode, vehicle_mask
from hulldown.annotate.oriented import mask_rectangle
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.camera.target import PosedVehicle, VehicleTarget
from hulldown.camera.world import World
from hulldown.dataset.verification.planned import label_records
from hulldown.planning.row import PlannedVehicle, Row


def annotation_records(row: Row, segmentations: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What `annotations.json` says about each labelled vehicle of a row, but for the id."""
    return [{**label, **mask} for label, mask in zip(label_records(row), segmentations, strict=True)]


class Segmenter:
    """Visible masks of the vehicles of a plan's rows.

    Parameters
    ----------
    vehicles, sceneries
        By the names that the plan uses; distractors are among the vehicles.
    """

    def __init__(self, vehicles: Mapping[str, VehicleShape], sceneries: Mapping[str, Scenery]) -> None:
        self._vehicles, self._sceneries = vehicles, sceneries
        self._targets: dict[str, VehicleTarget] = {}
        self._world: tuple[str, World] = ("", World())  # the scenery last asked for: rows come sorted

    def segmentations(self, row: Row) -> list[dict[str, Any]]:
        """`segmentation` (compressed run lengths), `area` (pixels), and `obb` of each labelled vehicle of a row."""
        records = []
        for mask in self._masks(row, row.labelled):
            encoded = encode(mask)
            records.append({"segmentation": encoded, "area": area(mask), "obb": _rectangle(encoded, row)})
        return records

    def pixels(self, row: Row, vehicles: Sequence[PlannedVehicle]) -> list[int]:
        """How many pixels show each of some vehicles of a row that are in the frame."""
        return [area(mask) for mask in self._masks(row, vehicles)]

    def _masks(self, row: Row, vehicles: Sequence[PlannedVehicle]) -> Iterator[Bool[np.ndarray, "h w"]]:
        posed = [(vehicle, self._posed(vehicle)) for vehicle in row.vehicles]
        camera, scenery = row.camera, self._scenery(row.scenery)
        for target in vehicles:
            (vehicle,) = (mine for whose, mine in posed if whose is target)
            others = [other for whose, other in posed if whose is not target]
            yield vehicle_mask(vehicle, camera, xywh=np.array(target.bbox), world=scenery.with_vehicles(others))

    def left_out(self, row: Row) -> Bool[np.ndarray, "h w"]:
        """Where an empty background would show the vehicle that it is framed on."""
        world = self._scenery(row.scenery).with_vehicles([self._posed(vehicle) for vehicle in row.vehicles])
        return vehicle_mask(self._posed(row.target), row.camera, xywh=np.array(row.target.bbox), world=world)

    def _posed(self, vehicle: PlannedVehicle) -> PosedVehicle:
        name = vehicle.vehicle
        if name not in self._targets:
            self._targets[name] = VehicleTarget(self._vehicles[name])
        return PosedVehicle(self._targets[name], vehicle.world_from_vehicle[None], vehicle.articulation)

    def _scenery(self, name: str) -> World:
        if self._world[0] != name:
            self._world = name, World.of(self._sceneries[name])
        return self._world[1]


def _rectangle(segmentation: Mapping[str, Any], row: Row) -> list[float] | None:
    """`mask_rectangle` as records have it: to 1e-6 pixels, and 1e-9 radians."""
    found = mask_rectangle(segmentation, row.width, row.height)
    return None if found is None else [*np.round(found[:4], 6).tolist(), round(float(found[4]), 9)]
