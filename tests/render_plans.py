"""A plan of cubes in a void and its assets, for runs with a stand-in for Blender."""

from pathlib import Path

import numpy as np
import orjson

from hulldown.dataset.store.document import read_coco
from hulldown.render.jobs import RenderAssets, SceneryFile, VehicleFile
from hulldown.tests.shapes import box, scenery_of, vehicle_of

ASSETS = RenderAssets(
    {"cube": VehicleFile(vehicle_of(box((-1, -1, 0), (1, 1, 2)), name="cube"), Path("cube.blend"))},
    {"void": SceneryFile(Path("void.blend"), np.eye(4), scenery_of("void"))},
    {"sky": Path("sky.exr")},
)


def make_row(i, **changes):
    """A cube whose near face is 10 m before a camera that looks along +x."""
    target = {
        "vehicle": "cube",
        "category": "box",
        "world_from_vehicle": np.eye(4).tolist(),
        "articulation": {},
        "bbox": [6.0, 6.0, 4.0, 4.0],
        "bbox_amodal": [6.0, 6.0, 4.0, 4.0],
        "visible_fraction": 1.0,
        "truncated_fraction": 0.0,
        "slope_deg": 0.0,
        "gap": 0.0,
        "penetration": 0.0,
        "tries": 1,
        **{"label": "full", "bounds": [[-1.0] * 3, [1.0] * 3], "paint": [], "air_contrast": 1.0},
    }
    camera = [[0.0, 0.0, 1.0, -11.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]]
    row = {
        **{"index": i, "image_id": i + 1, "file_name": f"images/{i + 1:08d}.png", "scenery": "void"},
        **{"position": i, "shot": 0, "world_from_camera": camera, "fov_x_deg": 53.13010235415598},
        **{"width": 16, "height": 16, "hdri": "sky", "hdri_yaw_deg": 0.0, "strength": 1.0, "weather": None},
        **{"background": False, "horizon_deg": None, "exposure_ev": 0.0, "white_balance_k": 0.0},
        **{"sample_seed": i, "companions": [], "distractors": [], "rejected": {}, "left_out": 0},
        **target,
    }
    return {**row, **changes}


def write_plan(folder, rows):
    folder.mkdir(parents=True, exist_ok=True)
    header = {
        **{"hulldown_plan": 3, "seed": 0, "root": ".", "images": len(rows)},
        "config": {
            "assets": {
                "vehicles": [{"path": "cube.blend", "category": "box"}],
                "sceneries": [{"path": "void.blend"}],
            },
            "budget": {"images_per_class": len(rows)},
            "render": {"samples": 1, "denoise": False, "adaptive_threshold": 0.0, "bounces": 1},
        },
        "vehicles": {"cube": {"path": "cube.blend", "sha256": "", "category": "box"}},
        "sceneries": {"void": {"path": "void.blend", "sha256": "", "origin": [0, 0, 0]}},
        "hdris": {"sky": {"path": "sky.exr", "sha256": ""}},
        **{"distractors": {}, "versions": {}, "left_out": []},
    }
    path = folder / "plan.jsonl"
    path.write_bytes(b"".join(orjson.dumps(r, option=orjson.OPT_APPEND_NEWLINE) for r in [header, *rows]))
    return path


def contents(folder):
    """Everything that makes a dataset what it is."""
    pictures = {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*.png"))}
    coco = read_coco(folder)
    return coco["images"], coco["annotations"], coco["categories"], pictures
