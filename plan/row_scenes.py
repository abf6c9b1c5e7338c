"""The scene of a row: its scenery with its vehicles, made from the assets in one place."""

from __future__ import annotations

from collections.abc import Mapping

from hulldown.assets.plan_assets import content_key
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.plan.row import PlannedVehicle, Row
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle, VehicleCaster


class RowScenes:
    """Makes scenes of rows, preparing each model once; a plane at `fallback_z` replaces missing ground."""

    def __init__(
        self, vehicles: Mapping[str, VehicleShape], sceneries: Mapping[str, Scenery], *, fallback_z: float | None = None
    ) -> None:
        self._vehicles, self._sceneries, self._fallback_z = vehicles, sceneries, fallback_z
        self._casters: dict[tuple[int, ...], VehicleCaster] = {}
        self._worlds: dict[tuple[int, ...], Scene] = {}

    def posed_vehicle(self, vehicle: PlannedVehicle) -> PosedVehicle:
        """Return a vehicle in its pose."""
        shape = self._vehicles[vehicle.vehicle]
        if (key := content_key(shape)) not in self._casters:
            self._casters[key] = VehicleCaster(shape)
        return PosedVehicle(self._casters[key], vehicle.world_from_vehicle[None], vehicle.articulation)

    def scene(self, row: Row) -> Scene:
        """Return a row's scenery with the vehicles in its picture."""
        scenery = self._sceneries[row.scenery]
        if (key := content_key(scenery)) not in self._worlds:
            self._worlds[key] = Scene.from_scenery(scenery, fallback_z=self._fallback_z)
        return self._worlds[key].with_vehicles([self.posed_vehicle(vehicle) for vehicle in row.vehicles])
