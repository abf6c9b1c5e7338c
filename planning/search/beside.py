"""Poses of companions that fill the other boxes of the photographs that targets follow."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Int

from hulldown.camera.framing import turned
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.projection import directions
from hulldown.camera.shell import camera_pose
from hulldown.geometry.portable import hypot, log, sin_cos
from hulldown.geometry.transforms import BOX_CORNERS, rotate
from hulldown.planning.search.instance_table import Instances
from hulldown.planning.search.likeness import Likeness, Wishes
from hulldown.planning.search.matching_cameras import DIRECTIONS, chosen_directions, fitting
from hulldown.planning.search.random_streams import RowStreams

STEEP = math.radians(15.0)  # elevation above which level ground tells a companion's distance better than its box does
FLAT = 0.05  # least fall of a ray that's followed to the ground, relative to its length
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def poses_beside(
    likeness: Likeness,
    targets: Instances,
    others: Instances,
    wishes: Wishes,
    *,
    number: Int[np.ndarray, " n"],
    intrinsics: Intrinsics,
    rng: RowStreams,
) -> Float[np.ndarray, "n 3"]:
    """Return places and headings on level ground at which companions fill the other boxes of the photographs.

    A companion is on the ray through its box's center. Its distance follows from the box's height, or in steep views,
    where a box shows length and width, from where the ray meets the ground.
    """
    photographs, limits = likeness.photographs, likeness.config
    poses = np.full((len(number), 3), np.nan)
    azimuth, elevation, distance = chosen_directions(targets, wishes, limits, intrinsics=intrinsics, rng=rng)
    turn = rng.random((len(number) * DIRECTIONS,)).reshape(-1, DIRECTIONS)
    # Companions of an image have the same random numbers.
    yaw = 2.0 * math.pi * (turn + GOLDEN * number[:, None])
    has = np.flatnonzero(number < likeness.companions(wishes.box))
    start = np.searchsorted(photographs.image, photographs.image[wishes.box])
    box, of_target = (start + number + (start + number >= wishes.box))[has], wishes.box[has]
    distance, yaw, intrinsics = distance[has], yaw[has], intrinsics.rows(has)
    size, tall = (each.fleet.size[each.model[has]] for each in (others, targets))

    # Relative to the target's center, with the target where its box is.
    level = camera_pose(np.zeros((len(has), 3)), distance, azimuth[has], elevation[has])
    camera = turned(level, intrinsics, photographs.center[of_target] * intrinsics.size)
    ray = rotate(camera[:, :3, :3], directions(intrinsics, (photographs.center[box] * intrinsics.size)[:, None]))[:, 0]
    ray /= np.sqrt((ray * ray).sum(axis=1, keepdims=True))
    by_height = distance * size[:, 2] / tall[:, 2] * photographs.height[of_target] / photographs.height[box]
    to_ground = (level[:, 2, 3] + (tall[:, 2] - size[:, 2]) / 2.0) / np.maximum(-ray[:, 2], FLAT)
    steep = (elevation[has] > STEEP) & (ray[:, 2] < -FLAT)
    away = np.where(steep, to_ground, by_height)[:, None] * ray

    sy, cy = (part[..., None] for part in sin_cos(yaw))
    x, y, z = np.moveaxis(BOX_CORNERS * (size[:, None] / 2.0), 2, 0)[:, :, None]
    corners = np.stack(np.broadcast_arrays(cy * x - sy * y, sy * x + cy * y, z), axis=-1) + away[:, None, None]
    right, down, ahead = np.moveaxis(corners @ camera[:, None, :3, :3], 3, 0)
    ahead = np.maximum(ahead, 0.1 * distance[:, None, None])
    aspect = np.ptp(right / ahead, axis=2) / np.ptp(down / ahead, axis=2)
    whole = ~photographs.cut[box].any(axis=1, keepdims=True)
    misfit = np.where(whole, log(aspect) - log(photographs.aspect[box])[:, None], 0.0)
    poses[has, 2] = yaw[np.arange(len(has)), fitting(misfit, limits.camera, wishes.choice[has])]

    xy = level[:, :2, 3] + away[:, :2]
    length = np.maximum(hypot(xy[:, 0], xy[:, 1]), 1e-9)
    poses[has, :2] = xy * (np.clip(length, *limits.placement.companion_distance) / length)[:, None]
    return poses
