"""The scene of a row: its scenery with its vehicles, made from the assets in one place."""

from __future__ import annotations

from collections.abc import Mapping

from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.plan.row import PlannedVehicle, Row
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster


class RowScenes:
    """Makes scenes of rows, models prepared once; `fallback_z`: height of a plane in place of missing ground."""

    def __init__(
        self,
        vehicles: Mapping[str, VehicleShape],
        sceneries: Mapping[str, Scenery],
        *,
        fallback_z: float | None = None,
    ) -> None:
        self._vehicles, self._sceneries, self._fallback_z = vehicles, sceneries, fallback_z
        self._casters: dict[str, VehicleCaster] = {}
        self._worlds: dict[str, Scene] = {}

    def posed_vehicle(self, vehicle: PlannedVehicle) -> PosedVehicle:
        """Return a vehicle in its pose."""
        name = vehicle.vehicle
        if name not in self._casters:
            self._casters[name] = VehicleCaster(self._vehicles[name])
        return PosedVehicle(self._casters[name], vehicle.world_from_vehicle[None], vehicle.articulation)

    def scene(self, row: Row) -> Scene:
        """Return a row's scenery with the vehicles in its picture."""
        name = row.scenery
        if name not in self._worlds:
            self._worlds[name] = Scene.of(self._sceneries[name], fallback_z=self._fallback_z)
        return self._worlds[name].with_vehicles([self.posed_vehicle(vehicle) for vehicle in row.vehicles])
