"""COCO records of a plan's rows, with masks by Embree, which equal Cycles' to the pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import orjson
from jaxtyping import Bool

from hulldown.annotate.coco_types import Record
from hulldown.annotate.label_list import compute_label_fields
from hulldown.annotate.label_type import LabeledVehicle, VehicleInScene
from hulldown.annotate.labels.keypoints import category_keypoint_fields
from hulldown.annotate.silhouettes import whole_and_visible_masks
from hulldown.assets.scenery import Scenery
from hulldown.assets.vehicle import VehicleShape
from hulldown.dataset.store.entries import new_category
from hulldown.plan.library import Library
from hulldown.plan.plan_file import Plan
from hulldown.plan.row import PlannedVehicle, Row, encode_line, row_fields
from hulldown.plan.row_scenes import RowScenes

IMAGE_KEYS = tuple(key for key, field in row_fields(Row).items() if field.recorded)
LABEL_KEYS = tuple(key for key, field in row_fields(PlannedVehicle).items() if field.recorded)


def recorded_image_fields(row: Row) -> Record:
    """Return the dataset record of a row's image, without id and file name."""
    record = orjson.loads(encode_line(row))
    return {key: record[key] for key in IMAGE_KEYS if key in record}


def planned_label_records(row: Row) -> list[Record]:
    """Return the dataset records of a row's labeled vehicles, without ids and without fields that need the scene."""
    return [_label_record(row, vehicle) for vehicle in row.labeled]


def _label_record(row: Row, vehicle: PlannedVehicle) -> Record:
    encoded = orjson.loads(encode_line(vehicle))
    planned = {key: encoded[key] for key in ("category", *LABEL_KEYS) if key in encoded}
    return {**planned, **compute_label_fields(_labeled_vehicle(row, vehicle)), "iscrowd": int(vehicle.label == "ignored")}


def _labeled_vehicle(row: Row, vehicle: PlannedVehicle, traced: VehicleInScene | None = None) -> LabeledVehicle:
    return LabeledVehicle(row.camera, vehicle.world_from_vehicle, np.array(vehicle.bounds), traced)


def plan_category_records(plan: Plan, shapes: Mapping[str, VehicleShape]) -> list[Record]:
    """Return records of a plan's categories, without ids; with `keypoints` and `skeleton`, if its config labels any."""
    header = plan.header
    annotate = plan.config.annotate
    labeled = [*header.vehicles, *(name for name, source in header.distractors.items() if source.category)]
    of_labeled = [shapes[name] for name in labeled]
    labels = category_keypoint_fields(of_labeled, annotate.keypoints, annotate.skeleton, path=plan.path)
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
        """Return a segmenter of a plan's rows, with the keypoints that its config labels."""
        categories = plan_category_records(plan, library.shapes)
        keypoints = next((category.get("keypoints", ()) for category in categories), ())
        return cls(library.shapes, library.assets.sceneries, keypoints=keypoints)

    def label_records_with_masks(self, row: Row) -> list[Record]:
        """Return an annotation record for each labeled vehicle of a row, without ids."""
        return [
            {
                **_label_record(row, vehicle),
                **compute_label_fields(_labeled_vehicle(row, vehicle, self._trace_vehicle(row, vehicle))),
            }
            for vehicle in row.labeled
        ]

    def _trace_vehicle(self, row: Row, vehicle: PlannedVehicle) -> VehicleInScene:
        posed, scene = self._scenes.posed_vehicle(vehicle), self._scenes.scene(row)
        others = scene.with_vehicles([p for p, v in zip(scene.vehicles, row.vehicles, strict=True) if v is not vehicle])
        whole, visible = whole_and_visible_masks(posed, row.camera, xywh=np.array(vehicle.bbox), world=others)
        return VehicleInScene(posed, scene, whole, visible, self._keypoints)

    def mask(self, row: Row, vehicle: PlannedVehicle) -> Bool[np.ndarray, "h w"]:
        """Return the visible mask of a row's vehicle; for a target that the picture leaves out, as if it were there."""
        return self._trace_vehicle(row, vehicle).visible
