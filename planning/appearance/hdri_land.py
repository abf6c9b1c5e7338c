"""Count images in which the terrain ends before the horizon and the land on an HDRI is visible behind it."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np

from hulldown.assets.library import Assets
from hulldown.camera.cameras import Cameras
from hulldown.geometry.indices import even_sample
from hulldown.plan.config.schema import Config
from hulldown.plan.lines import PlanFile
from hulldown.plan.row import Row
from hulldown.scene.posed_scene import Scene

LOOKED_AT = 1000  # images, evenly spread over the plan
COLUMNS, ROWS = 24, 16  # rays through an image
BELOW = math.sin(math.radians(-1.0))  # height of a ray that should meet ground
MIN_LAND_SHARE = 0.01  # share of an image above which the land counts as visible


def land_above_horizon(plan: PlanFile, assets: Assets) -> tuple[int, int]:
    """Return the number of images with an HDRI's land in place of terrain, and the number of examined images."""
    fallback_z = Config.of_plan(plan).ground.fallback_z
    chosen = even_sample(len(plan), LOOKED_AT).tolist()
    rows: dict[str, list[Row]] = defaultdict(list)
    for index in chosen:
        row = plan[index]
        if row.horizon_deg is None and assets.sky(row.hdri).shows_land:
            rows[row.scenery].append(row)
    count = 0
    for scenery, of_scenery in rows.items():
        world = Scene.of(assets.sceneries[scenery], fallback_z=fallback_z)
        for row in of_scenery:
            camera = Cameras(row.intrinsics.with_size(COLUMNS, ROWS), row.world_from_camera)
            along = camera.rays(camera.lenses.pixel_centers)[1]
            down = along[along[:, 2] < BELOW]
            missed = ~world.nearest(np.tile(camera.position, (len(down), 1)), down).hit
            count += int(missed.sum()) > MIN_LAND_SHARE * COLUMNS * ROWS
    return count, len(chosen)
