"""What a scenery shows from straight above, and ground so far below everything that nobody meant positions on it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from hulldown.assets.scenery import Scenery
from hulldown.reading.pieces.asset_report import TopView
from hulldown.reading.pieces.doubt import Doubt, DoubtKind
from hulldown.reading.scenery.shape import MIN_PIT_DEPTH_M
from hulldown.scene.posed_scene import Scene
from hulldown.scene.rays import Hits, RayList, SurfaceKind

VIEW_SIDE_RAYS = 128
MAX_FLOOR_HEIGHT_M = 1.0  # of the floor far below, which is a level sheet


def top_view_and_doubts(scenery: Scenery) -> tuple[TopView, list[Doubt]]:
    """Return the shares of what's seen from above within the bounds of the ground, or of all, and doubts about it."""
    world = Scene.from_scenery(scenery)
    boxes = world.obstacles.bounds
    around = scenery.ground.bounds[None] if scenery.ground else boxes
    low, high = around[:, 0].min(axis=0), around[:, 1].max(axis=0)
    cells = (np.arange(VIEW_SIDE_RAYS) + 0.5) / VIEW_SIDE_RAYS
    xy = low[:2] + np.stack(np.meshgrid(cells, cells), axis=-1).reshape(-1, 2) * (high - low)[:2]
    top = max(float(high[2]), float(boxes[:, 1, 2].max(initial=-np.inf))) + 1.0
    rays = RayList(np.column_stack([xy, np.full(len(xy), top)]), np.broadcast_to([0.0, 0.0, -1.0], (len(xy), 3)))
    hits = world.first_hits(rays)
    water = water_hit_mask(scenery, hits)
    kinds = hits.kind == SurfaceKind.GROUND, (hits.kind == SurfaceKind.OBSTACLE) & ~water, water, ~hits.hit
    ground, obstacle, wet, nothing = (round(float(np.mean(kind)), 4) for kind in kinds)
    heights = np.sort(top - Scene(world.ground).first_hits(rays).distance)
    heights = heights[np.isfinite(heights)]
    doubts = []
    if len(heights) > 1:
        floor = int(np.argmax(np.diff(heights)))
        depth, over = heights[floor + 1] - heights[floor], boxes[:, 0, 2] > heights[floor] + MIN_PIT_DEPTH_M
        if depth > MIN_PIT_DEPTH_M and over.all() and heights[floor] - heights[0] < MAX_FLOOR_HEIGHT_M:
            share = f"{100 * (floor + 1) / len(heights):.0f} % of the ground is {depth:.0f} m below everything else"
            text = "if nothing should stand there, make it an object of its own in Blender and name it in drop"
            doubts = [Doubt(DoubtKind.GROUND, f"{share}; {text}")]
    return TopView(ground, obstacle, wet, nothing), doubts


def water_hit_mask(scenery: Scenery, hits: Hits) -> Bool[np.ndarray, " n"]:
    """Return which rays into a scenery hit water."""
    return (hits.kind == SurfaceKind.OBSTACLE) & np.append(scenery.instance_is_water, False)[hits.instance]
