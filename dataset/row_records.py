"""COCO records of a plan's rows, with masks by Embree, which equal Cycles' to the pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import orjson
from jaxtyping import Bool

from hulldown.annotate.coco_types import Record
from hulldown.annotate.label_list import fields_from_poses, fields_from_scene
from hulldown.annotate.label_type import SeenVehicle, VehicleInCamera
from hulldown.annotate.labels.keypoints import category_fields
from hulldown.annotate.silhouettes import vehicle_masks
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.dataset.store.entries import new_category
from hulldown.plan.library import Library
from hulldown.plan.plan_file import Plan
from hulldown.plan.row import PlannedVehicle, Row, encode_line, row_fields
from hulldown.plan.row_scenes import RowScenes

IMAGE_KEYS = tuple(key for key, field in row_fields(Row).items() if field.recorded)
LABEL_KEYS = tuple(key for key, field in row_fields(PlannedVehicle).items() if field.recorded)


def image_record(row: Row) -> Record:
    """Return a dataset's record of a row's image, without id and file name."""
    record = orjson.loads(encode_line(row))
    return {key: record[key] for key in IMAGE_KEYS if key in record}


def label_records(row: Row) -> list[Record]:
    """Return a dataset's records of a row's labeled vehicles, without ids and what needs the scene."""
    records: list[Record] = []
    for vehicle in row.labeled:
        encoded, placed = (
            orjson.loads(encode_line(vehicle)),
            VehicleInCamera(row.camera, vehicle.world_from_vehicle, np.array(vehicle.bounds)),
        )
        planned = {key: encoded[key] for key in ("category", *LABEL_KEYS) if key in encoded}
        records.append({**planned, **fields_from_poses(placed), "iscrowd": int(vehicle.label == "ignored")})
    return records


def plan_categories(plan: Plan, shapes: Mapping[str, VehicleShape]) -> list[Record]:
    """Return records of a plan's categories, without ids; with `keypoints` and `skeleton`, if its config labels any."""
    header = plan.header
    annotate = plan.config.annotate
    labeled = [*header.vehicles, *(name for name, source in header.distractors.items() if source.category)]
    of_labeled = [shapes[name] for name in labeled]
    labels = category_fields(of_labeled, annotate.keypoints, annotate.skeleton, path=plan.path)
    return [{**new_category(name), **labels} for name in header.categories]


class Segmenter:
    """Makes label records of a plan's rows, with masks of their vehicles."""

    def __init__(
        self, vehicles: Mapping[str, VehicleShape], sceneries: Mapping[str, Scenery], *, keypoints: Sequence[str] = ()
    ) -> None:
        self._keypoints = keypoints
        self._scenes = RowScenes(vehicles, sceneries)

    @classmethod
    def of_plan(cls, plan: Plan, library: Library) -> Segmenter:
        """Return the one for a plan's rows, with the keypoints that its config labels."""
        categories = plan_categories(plan, library.shapes)
        keypoints = next((category.get("keypoints", ()) for category in categories), ())
        return cls(library.shapes, library.assets.sceneries, keypoints=keypoints)

    def records(self, row: Row) -> list[Record]:
        """Annotation records of each labeled vehicle of a row, without ids."""
        return [
            {**record, **fields_from_scene(self._seen(row, vehicle))}
            for vehicle, record in zip(row.labeled, label_records(row), strict=True)
        ]

    def _seen(self, row: Row, vehicle: PlannedVehicle) -> SeenVehicle:
        posed, scene = self._scenes.posed_vehicle(vehicle), self._scenes.scene(row)
        others = scene.with_vehicles([p for p, v in zip(scene.vehicles, row.vehicles, strict=True) if v is not vehicle])
        whole, visible = vehicle_masks(posed, row.camera, xywh=np.array(vehicle.bbox), world=others)
        return SeenVehicle(row.camera, posed, scene, whole, visible, self._keypoints)

    def mask(self, row: Row, vehicle: PlannedVehicle) -> Bool[np.ndarray, "h w"]:
        """Visible mask of a row's vehicle; of a target that is left out of the picture, as if it were there."""
        return self._seen(row, vehicle).visible
