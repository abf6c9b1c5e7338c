"""Which pixels' centers are on a vehicle, and which of these nothing hides, by rays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy.typing import ArrayLike

from hulldown.annotate.visibility import TOUCHING_M
from hulldown.base.arrays import checked_array
from hulldown.base.indices import group_and_rank
from hulldown.camera.cameras import NEAR_M, Cameras
from hulldown.geometry.transforms import rotate_vectors
from hulldown.scene.posed_scene import Scene
from hulldown.scene.posed_vehicle import PosedVehicle
from hulldown.scene.rays import RayList

FIRST_TESTED_PIXELS = 256
MAX_BATCH_RAYS = 1 << 18


def whole_and_visible_masks(
    vehicle: PosedVehicle, camera: Cameras, *, xywh: ArrayLike | None = None, world: Scene | None = None
) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Return the pixels in the box `xywh` whose center is on the vehicle, and those that nothing in `world` hides."""
    size = np.array([camera.lenses.width, camera.lenses.height])
    whole, mask = np.zeros((2, *size[::-1]), dtype=bool)
    box = np.append([0.0, 0.0], size) if xywh is None else checked_array(xywh, "xywh", (4,))
    first, end = _box_pixel_ranges(box, size)
    rows, columns = np.mgrid[first[1] : end[1], first[0] : end[0]].reshape(2, -1)
    if not len(rows):
        return whole, mask
    pixels = np.stack([columns, rows], axis=1) + 0.5
    along = camera.lenses.pixel_directions(pixels) @ camera.world_from_camera[:3, :3].T
    origins = camera.position + NEAR_M * along
    rays = RayList(origins, along)
    distance = vehicle.first_hits(rays).distance
    seen = np.flatnonzero(np.isfinite(distance))
    whole[rows[seen], columns[seen]] = True
    if world is not None:
        seen = seen[~world.occlusion(rays.take(seen), max_distance=distance[seen] - TOUCHING_M)]
    mask[rows[seen], columns[seen]] = True
    return whole, mask


def visible_subject_mask(
    subjects: Sequence[PosedVehicle], cameras: Cameras, *, xywh: Float[np.ndarray, "n 4"], world: Scene
) -> Bool[np.ndarray, " n"]:
    """Return whether any pixel's center shows each camera's subject; a few pixels are tested first."""
    shown = np.zeros(len(xywh), dtype=bool)
    first, end = _box_pixel_ranges(xywh, cameras.lenses.size)
    width, pixels = end[:, 0] - first[:, 0], (end - first).prod(axis=1)
    few = pixels // FIRST_TESTED_PIXELS + 1

    def look(rows: Int[np.ndarray, " k"], step: Int[np.ndarray, " k"]) -> None:
        """Test every step-th pixel of these cameras' boxes."""
        count = -(-pixels[rows] // step)
        row, number = group_and_rank(count)
        pixel = number * step[row]
        camera = rows[row]
        uv = np.stack([pixel % width[camera], pixel // width[camera]], axis=1) + first[camera] + 0.5
        each = cameras.take(camera)
        poses, along = each.world_from_camera, each.lenses.pixel_directions(uv[:, None])
        along = rotate_vectors(poses[:, :3, :3], along)[:, 0]
        rays, distance = RayList(poses[:, :3, 3] + NEAR_M * along, along, row), np.full(len(row), np.inf)
        for subject in subjects:
            met = subject.take(rows).first_hits(rays)
            distance = np.minimum(distance, met.distance)
        seen = np.flatnonzero(np.isfinite(distance))
        reach = distance[seen] - TOUCHING_M
        hidden = world.take(rows).occlusion(rays.take(seen), max_distance=reach)
        shown[camera[seen[~hidden]]] = True

    for step in (few, np.ones_like(few)):
        left = np.flatnonzero(~shown & (pixels > 0) & ((step is few) | (few > 1)))
        # As many cameras together as have some hundred thousand rays between them.
        block = np.cumsum(-(-pixels[left] // step[left])) // MAX_BATCH_RAYS
        for some in np.split(left, np.flatnonzero(np.diff(block)) + 1):
            if len(some):
                look(some, step[some])
    return shown


def _box_pixel_ranges(
    xywh: Float[np.ndarray, "... 4"], size: Shaped[np.ndarray, "... 2"]
) -> tuple[Int[np.ndarray, "... 2"], Int[np.ndarray, "... 2"]]:
    first = np.clip(np.ceil(xywh[..., :2] - 0.5), 0, size).astype(int)
    return first, np.clip(np.floor(xywh[..., :2] + xywh[..., 2:] - 0.5) + 1, first, size).astype(int)
