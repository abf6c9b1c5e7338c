"""From arrays to the rows of a plan file: plain dictionaries of numbers, strings and lists."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from planning.group import Group, Planned
from planning.light import Lights
from planning.refusal import Refusal
from planning.schema import Config


def rows_of(
    group: Group, planned: Planned, lights: Lights, config: Config, hdris: tuple[str, ...]
) -> list[dict[str, Any]]:
    """One row for each image of a group, in the group's order."""
    stands, shots, shape = planned.stands, planned.shots, group.model.shape
    vehicles = stands.world_from_vehicle.tolist()
    slope, gap, penetration = stands.slope_deg.tolist(), stands.gap.tolist(), stands.penetration.tolist()
    position, tries = group.position.tolist(), planned.tries.tolist()
    kinds = [refusal.key for refusal in Refusal]
    columns = zip(
        group.owner.tolist(),
        group.shot.tolist(),
        group.image.tolist(),
        shots.world_from_camera.tolist(),
        shots.fov_x_deg.tolist(),
        shots.bbox.tolist(),
        shots.bbox_amodal.tolist(),
        shots.visible_fraction.tolist(),
        shots.truncated_fraction.tolist(),
        lights.hdri.tolist(),
        lights.yaw_deg.tolist(),
        lights.strength.tolist(),
        lights.visibility_m.tolist(),
        lights.sample_seed.tolist(),
        planned.rejected.tolist(),
        _companions(group, planned),
        strict=True,
    )
    width, height = config.render.width, config.render.height
    return [
        {
            "index": image,
            "image_id": image + 1,
            "file_name": f"images/{image + 1:08d}.png",
            "scenery": group.site.name,
            "position": position[i],
            "shot": shot,
            "world_from_camera": camera,
            "fov_x_deg": fov,
            "width": width,
            "height": height,
            "hdri": hdris[hdri],
            "hdri_yaw_deg": yaw,
            "strength": strength,
            "weather": None if visibility != visibility else {"visibility_m": visibility},
            "sample_seed": seed,
            "vehicle": shape.name,
            "category": group.model.category,
            "world_from_vehicle": vehicles[i],
            "articulation": planned.articulation[i],
            "bbox": bbox,
            "bbox_amodal": amodal,
            "visible_fraction": visible,
            "truncated_fraction": truncated,
            "slope_deg": slope[i],
            "gap": gap[i],
            "penetration": penetration[i],
            "tries": tries[i],
            "companions": companions,
            "rejected": {kind: n for kind, n in zip(kinds, rejected, strict=True) if n},
        }
        for (
            i, shot, image, camera, fov, bbox, amodal, visible, truncated,
            hdri, yaw, strength, visibility, seed, rejected, companions,
        ) in columns
    ]  # fmt: skip


def _companions(group: Group, planned: Planned) -> list[list[dict[str, Any]]]:
    """For each image of a group the records of its companions."""
    company = planned.companions
    if not company.slots:
        return [[] for _ in range(len(group.image))]
    standing: list[list[dict[str, Any]]] = [[] for _ in range(len(group.position))]
    for slot in company.slots:
        for i in np.flatnonzero(slot.model >= 0).tolist():
            model = company.models[int(slot.model[i])]
            standing[i].append(
                {
                    "vehicle": model.shape.name,
                    "category": model.category,
                    "world_from_vehicle": slot.stands.world_from_vehicle[i].tolist(),
                    "articulation": slot.articulation[i],
                    "slope_deg": float(slot.stands.slope_deg[i]),
                    "gap": float(slot.stands.gap[i]),
                    "penetration": float(slot.stands.penetration[i]),
                    "tries": int(slot.tries[i]),
                }
            )
    return [
        [{**one, **asdict(seen)} for one, seen in zip(standing[i], glimpses, strict=True)]
        for i, glimpses in zip(group.owner.tolist(), planned.glimpses, strict=True)
    ]
