"""COCO records of a plan's rows, with masks by Embree, which equal Cycles' to the pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from hulldown.annotate.silhouettes import vehicle_masks
from hulldown.assets.coco_types import Record
from hulldown.assets.scenery import Scenery
from hulldown.assets.skeleton import category_fields
from hulldown.assets.vehicle import VehicleShape
from hulldown.dataset.labels.label_type import SeenVehicle
from hulldown.dataset.labels.types import fields_of_scene
from hulldown.dataset.rows import label_records
from hulldown.dataset.store.entries import new_category
from hulldown.planning.plan.row import PlannedVehicle, Row
from hulldown.planning.plan.row_scenes import RowScenes
from hulldown.planning.plan_file import Plan


def categories_of(plan: Plan, shapes: Mapping[str, VehicleShape]) -> list[Record]:
    """Return records of a plan's categories, without ids; with `keypoints` and `skeleton`, if its config labels any."""
    header = plan.header
    annotate = plan.config.annotate
    labeled = [*header.vehicles, *(name for name, source in header.distractors.items() if source.category)]
    of_labeled = [shapes[name] for name in labeled]
    fields = category_fields(of_labeled, annotate.keypoints, annotate.skeleton, path=plan.path)
    return [{**new_category(name), **fields} for name in header.categories]


class Segmenter:
    """Makes label records of a plan's rows, with masks of their vehicles."""

    def __init__(
        self, vehicles: Mapping[str, VehicleShape], sceneries: Mapping[str, Scenery], *, keypoints: Sequence[str] = ()
    ) -> None:
        self._keypoints = keypoints
        self._scenes = RowScenes(vehicles, sceneries)

    def records(self, row: Row) -> list[Record]:
        """Annotation records of each labeled vehicle of a row, without ids."""
        return [
            {**record, **fields_of_scene(self._seen(row, vehicle))}
            for vehicle, record in zip(row.labeled, label_records(row), strict=True)
        ]

    def _seen(self, row: Row, vehicle: PlannedVehicle) -> SeenVehicle:
        """Return a row's vehicle in its scene; a target that is left out of the picture, as if it were there."""
        posed, scene = self._scenes.posed(vehicle), self._scenes.scene(row)
        others = scene.with_vehicles([p for p, v in zip(scene.vehicles, row.vehicles, strict=True) if v is not vehicle])
        whole, visible = vehicle_masks(posed, row.camera, xywh=np.array(vehicle.bbox), world=others)
        return SeenVehicle(row, posed, scene, whole, visible, self._keypoints)

    def mask(self, row: Row, vehicle: PlannedVehicle) -> Bool[np.ndarray, "h w"]:
        """Visible mask of a row's vehicle; of a target that is left out of the picture, as if it were there."""
        return self._seen(row, vehicle).visible
