"""From arrays to the rows of a plan; poses and angles come rounded already, since all else follows from them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planning.company import Company, Slot
from planning.group import Group, Planned
from planning.light import Lights
from planning.refusal import Refusal
from planning.row import Box, PlannedVehicle, Row, Weather, picture_name, rounded
from planning.schema import Config


def rows_of(group: Group, planned: Planned, lights: Lights, config: Config, hdris: tuple[str, ...]) -> list[Row]:
    """One row for each image of a group, in the group's order."""
    stands, shots, shape = planned.stands, planned.shots, group.model.shape
    slope, gap, penetration = (rounded(k, getattr(stands, k)).tolist() for k in ("slope_deg", "gap", "penetration"))
    position, tries = group.position.tolist(), planned.tries.tolist()
    kinds = [refusal.key for refusal in Refusal]
    columns = zip(
        group.owner.tolist(),
        group.shot.tolist(),
        group.image.tolist(),
        shots.world_from_camera,
        shots.fov_x_deg.tolist(),
        rounded("bbox", shots.bbox).tolist(),
        rounded("bbox_amodal", shots.bbox_amodal).tolist(),
        rounded("visible_fraction", shots.visible_fraction).tolist(),
        rounded("truncated_fraction", shots.truncated_fraction).tolist(),
        lights.hdri.tolist(),
        rounded("hdri_yaw_deg", lights.yaw_deg).tolist(),
        rounded("strength", lights.strength).tolist(),
        rounded("weather", lights.visibility_m).tolist(),
        lights.sample_seed.tolist(),
        planned.rejected.tolist(),
        _companions(group, planned),
        strict=True,
    )
    width, height = config.render.width, config.render.height
    return [
        Row(
            vehicle=shape.name,
            category=group.model.category,
            world_from_vehicle=stands.world_from_vehicle[i],
            articulation=planned.articulation[i],
            bbox=Box(*bbox),
            bbox_amodal=Box(*amodal),
            visible_fraction=visible,
            truncated_fraction=truncated,
            slope_deg=slope[i],
            gap=gap[i],
            penetration=penetration[i],
            tries=tries[i],
            index=image,
            image_id=image + 1,
            file_name=picture_name(image),
            scenery=group.site.name,
            position=position[i],
            shot=shot,
            world_from_camera=camera,
            fov_x_deg=fov,
            width=width,
            height=height,
            hdri=hdris[hdri],
            hdri_yaw_deg=yaw,
            strength=strength,
            weather=None if visibility != visibility else Weather(visibility_m=visibility),
            sample_seed=seed,
            companions=companions,
            rejected={kind: n for kind, n in zip(kinds, rejected, strict=True) if n},
        )
        for (
            i, shot, image, camera, fov, bbox, amodal, visible, truncated,
            hdri, yaw, strength, visibility, seed, rejected, companions,
        ) in columns
    ]  # fmt: skip


def _companions(group: Group, planned: Planned) -> list[list[PlannedVehicle]]:
    """For each image of a group its companions: those of one slot after the other, as its camera sees them."""
    glimpses = [seen for image in planned.glimpses for seen in image]
    boxes, amodal = (_boxes([getattr(seen, key) for seen in glimpses]) for key in ("bbox", "bbox_amodal"))
    visible, truncated = (
        rounded(key, np.array([getattr(seen, key) for seen in glimpses], dtype=np.float64)).tolist()
        for key in ("visible_fraction", "truncated_fraction")
    )
    seen = zip(boxes, amodal, visible, truncated, strict=True)
    standing = [_standing(planned.companions, slot) for slot in planned.companions.slots]
    return [
        [standing[k](i, *next(seen)) for k in range(len(image))]
        for i, image in zip(group.owner.tolist(), planned.glimpses, strict=True)
    ]


def _standing(company: Company, slot: Slot) -> Callable[[int, Box | None, Box | None, float, float], PlannedVehicle]:
    """What makes the record of a position's companion in this slot, once it is known what a camera sees of it."""
    stands, model, tries = slot.stands, slot.model.tolist(), slot.tries.tolist()
    slope, gap, penetration = (rounded(k, getattr(stands, k)).tolist() for k in ("slope_deg", "gap", "penetration"))

    def record(i: int, bbox: Box | None, bbox_amodal: Box | None, visible: float, truncated: float) -> PlannedVehicle:
        return PlannedVehicle(
            vehicle=company.models[model[i]].shape.name,
            category=company.models[model[i]].category,
            world_from_vehicle=stands.world_from_vehicle[i],
            articulation=slot.articulation[i],
            bbox=bbox,
            bbox_amodal=bbox_amodal,
            visible_fraction=visible,
            truncated_fraction=truncated,
            slope_deg=slope[i],
            gap=gap[i],
            penetration=penetration[i],
            tries=tries[i],
        )

    return record


def _boxes(boxes: list[list[float] | None]) -> list[Box | None]:
    numbers = rounded("bbox", np.array([box or [np.nan] * 4 for box in boxes]).reshape(-1, 4)).tolist()
    return [None if box is None else Box(*xywh) for box, xywh in zip(boxes, numbers, strict=True)]
