"""COCO records of a plan's rows, with masks by Embree, which equal Cycles' to the pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from hulldown.annotate.keypoint_visibility import keypoints_in_image
from hulldown.annotate.masks import encode, vehicle_mask
from hulldown.annotate.rectangles import mask_rectangle
from hulldown.assets.scenery import Scenery
from hulldown.assets.skeleton import category_fields
from hulldown.assets.vehicle import VehicleShape
from hulldown.dataset.rows import label_records
from hulldown.dataset.store.entries import new_category
from hulldown.planning.plan.row import PlannedVehicle, Row
from hulldown.planning.plan.row_scenes import RowScenes
from hulldown.planning.plan_file import Plan


def categories_of(plan: Plan, shapes: Mapping[str, VehicleShape]) -> list[dict[str, Any]]:
    """Records of the categories of a plan, without ids; with `keypoints` and `skeleton`, if its config labels any.

    Raises
    ------
    ConfigError
        If it lists keypoints that no vehicle has.
    """
    header = plan.header
    annotate = plan.config.annotate
    labeled = [*header.vehicles, *(name for name, source in header.distractors.items() if source.category)]
    of_labeled = [shapes[name] for name in labeled]
    fields = category_fields(of_labeled, annotate.keypoints, annotate.skeleton, path=plan.path)
    return [new_category(name) | fields for name in header.categories]


class Segmenter:
    """Visible masks of the vehicles of a plan's rows.

    Parameters
    ----------
    vehicles, sceneries
        Vehicles, distractors included, and sceneries, by their names in the plan.
    keypoints
        Names of the labels' keypoints, in order; empty: no keypoints.
    """

    def __init__(
        self, vehicles: Mapping[str, VehicleShape], sceneries: Mapping[str, Scenery], *, keypoints: Sequence[str] = ()
    ) -> None:
        self._vehicles, self._keypoints = vehicles, keypoints
        self._scenes = RowScenes(vehicles, sceneries)

    def records(self, row: Row) -> list[dict[str, Any]]:
        """Annotation records of each labeled vehicle of a row, without ids."""
        records = []
        for vehicle, record in zip(row.labeled, label_records(row), strict=True):
            mask = self.mask(row, vehicle)
            encoded = encode(mask)
            record |= {"segmentation": encoded, "area": int(np.count_nonzero(mask)), "obb": _rectangle(encoded, row)}
            records.append(record | (self._seen_keypoints(row, vehicle) if self._keypoints else {}))
        return records

    def _seen_keypoints(self, row: Row, vehicle: PlannedVehicle) -> dict[str, Any]:
        keypoints = keypoints_in_image(self._scenes.posed(vehicle), row.camera, self._scenes.scene(row))
        seen = dict(zip(self._vehicles[vehicle.vehicle].keypoint_names, keypoints.tolist(), strict=True))
        listed = [seen.get(name, (0.0, 0.0, 0.0)) for name in self._keypoints]
        flat = [number for x, y, v in listed for number in (round(x, 6), round(y, 6), int(v))]
        return {"keypoints": flat, "num_keypoints": sum(v > 0 for _, _, v in listed)}

    def mask(self, row: Row, vehicle: PlannedVehicle) -> Bool[np.ndarray, "h w"]:
        """Visible mask of a row's vehicle; of a target that is left out of the picture, as if it were there."""
        others = self._scenes.scene(row, [other for other in row.vehicles if other is not vehicle])
        return vehicle_mask(self._scenes.posed(vehicle), row.camera, xywh=np.array(vehicle.bbox), world=others)


def _rectangle(segmentation: Mapping[str, Any], row: Row) -> list[float] | None:
    """`mask_rectangle` for records, rounded to 1e-6 pixels and 1e-9 radians."""
    rectangle = mask_rectangle(segmentation, row.width, row.height)
    return None if rectangle is None else [*np.round(rectangle[:4], 6).tolist(), round(float(rectangle[4]), 9)]
