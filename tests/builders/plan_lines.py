"""Handwritten lines of a plan: its header, and rows in which tests change a key."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from hulldown.plan.row import PlannedVehicle, Row

POSE = np.eye(4).tolist()
HEADER = {
    **{"hulldown_plan": 4, "images": 5, "seed": 0, "root": ".", "config": {}, "vehicles": {}, "sceneries": {}},
    **{"hdris": {}, "distractors": {}, "versions": {}, "left_out": []},
}
VEHICLE = {
    **{"role": "target", "vehicle": "t72", "category": "tank", "world_from_vehicle": POSE},
    **{"articulation": {"turret": 0.1}},
    **{"bbox": [5.0, 4.0, 10.0, 6.0], "bbox_amodal": [5.0, 4.0, 10.0, 7.0], "visible_fraction": 0.75},
    **{"truncated_fraction": 1 / 7, "slope_deg": 2.0, "gap": 0.1, "penetration": 0.0, "tries": 1, "label": "full"},
    **{"bounds": [[-3.0, -1.5, 0.0], [3.0, 1.5, 2.5]], "air_contrast": 0.9},
    "paint": [{"materials": ["camo*"], "color": "#4b5320"}],
}
IMAGE = {
    **{"scenery": "hills", "position": 0, "shot": 0, "world_from_camera": POSE, "fov_x_deg": 50.0, "width": 32},
    **{"height": 24, "hdri": "noon", "hdri_yaw_deg": 3.5, "strength": 1.0, "horizon_deg": None, "exposure_ev": 0.5},
    **{"white_balance_k": -120.0, "weather": None, "sample_seed": 7, "background": False},
    **{"rejected": {}, "left_out": 0},
}


def row(index: int, *, companions: list = (), distractors: list = (), **changes: object) -> dict:
    """A row; changes of a vehicle's keys are the target's."""
    name = f"images/{index + 1:08d}.png"
    target = {**VEHICLE, **{key: changes.pop(key) for key in list(changes) if key in (*VEHICLE, "geo", "track_id")}}
    groups = {"companion": companions, "distractor": distractors}
    extras = [{**each, "role": role} for role, group in groups.items() for each in group]
    return {**IMAGE, "index": index, "image_id": index + 1, "file_name": name, "planned": [target, *extras], **changes}


def altered(record: Row | PlannedVehicle, **changes: object) -> Row | PlannedVehicle:
    """A record with changes; those of a row may be its target, companions, or distractors."""
    groups = {name: changes.pop(name) for name in ("target", "companions", "distractors") if name in changes}
    if groups:
        parts = {name: getattr(record, name) for name in ("target", "companions", "distractors")} | groups
        changes["planned"] = [parts["target"], *parts["companions"], *parts["distractors"]]
    return replace(record, **changes)


def line(record: dict) -> bytes:
    return json.dumps(record).encode() + b"\n"


def write_lines(path: Path, rows: list[dict], **header: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(map(line, [{**HEADER, "images": len(rows), **header}, *rows])))
    return path
