"""Images of a plan in which the terrain ends before the horizon, so that the land on an HDRI is seen behind it."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np

from hulldown.assets.library import Assets
from hulldown.camera.projection import Camera
from hulldown.camera.world import World
from hulldown.geometry.arrays import spread
from hulldown.planning.plan_file import Plan
from hulldown.planning.row import Row

LOOKED_AT = 1000  # images, evenly from the plan
COLUMNS, ROWS = 24, 16  # rays through an image
BELOW = math.sin(math.radians(-1.0))  # height of a ray that should meet ground
SEEN = 0.01  # of an image: what nobody notices


def land_above_horizon(plan: Plan, assets: Assets) -> tuple[int, int]:
    """Return how many of a plan's images show an HDRI's land where terrain should be, and how many were looked at.

    Parameters
    ----------
    plan
        At most `LOOKED_AT` of its images are looked at, whose HDRIs show land and are seen as they are.
    assets
        Those the plan was made from.
    """
    fallback_z = plan.config.ground.fallback_z
    chosen = spread(len(plan), LOOKED_AT).tolist()
    rows: dict[str, list[Row]] = defaultdict(list)
    for index in chosen:
        row = plan[index]
        if row.horizon_deg is None and assets.sky(row.hdri).shows_land:
            rows[row.scenery].append(row)
    count = 0
    for scenery, those in rows.items():
        world = World.of(assets.sceneries[scenery], fallback_z=fallback_z)
        for row in those:
            camera = Camera(row.intrinsics.resized(COLUMNS, ROWS), row.world_from_camera)
            x, y = np.meshgrid(np.arange(COLUMNS) + 0.5, np.arange(ROWS) + 0.5)
            along = camera.ray_directions(np.stack([x.ravel(), y.ravel()], axis=1))
            down = along[along[:, 2] < BELOW]
            missed = ~world.nearest(np.tile(camera.position, (len(down), 1)), down).hit
            count += int(missed.sum()) > SEEN * COLUMNS * ROWS
    return count, len(chosen)
