"""Cameras that reproduce the boxes of photographs, and companions that fill the other boxes beside them."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import place_boxes, turned
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose, draw_azimuth, draw_elevation, shell_axes
from hulldown.geometry.portable import exp, hypot, log, sin_cos
from hulldown.geometry.transforms import BOX_CORNERS, rotate
from hulldown.plan.config.scene_sections import CameraSection
from hulldown.planning.search.instance_table import Instances, hull_of
from hulldown.planning.search.likeness import TRUNCATION_MARGIN, Likeness, TargetBoxes
from hulldown.planning.search.random_streams import Purpose, RandomStreams, RowStreams, choose
from hulldown.planning.search.sizing import size_cameras

MIN_STEEP_RADIANS = math.radians(
    15.0
)  # elevation from which level ground tells a companion's distance better than its box
MIN_RAY_FALL = 0.05  # of a ray that's followed to the ground, relative to its length
GOLDEN_RATIO = (math.sqrt(5.0) - 1.0) / 2.0
CAMERA_DIRECTIONS = 24  # candidates for each camera
MIN_ASPECT_TOLERANCE = 0.03  # relative, of aspect ratios: no vehicle has exactly the sampled one
MAX_DISTANCE_ERROR = 2.0  # largest factor by which estimated distances are wrong


def candidate_directions(
    draws: RandomStreams, image: Int[np.ndarray, " n"], attempt: Int[np.ndarray, " n"]
) -> RowStreams:
    """Return the generator for the candidate directions of these tries."""
    tries = attempt[:, None] * CAMERA_DIRECTIONS + np.arange(CAMERA_DIRECTIONS)
    return RowStreams(draws, Purpose.DIRECTION, np.repeat(image, CAMERA_DIRECTIONS), tries.ravel())


def match_cameras(
    targets: Instances,
    boxes: TargetBoxes,
    limits: CameraSection,
    *,
    lenses: Intrinsics,
    roll: Float[np.ndarray, " n"],
    rng: RowStreams,
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, " n"]]:
    """Return cameras that reproduce size and place of photographs' boxes, and their distances; nan without one."""
    n = len(targets)
    azimuth, elevation, distance = choose_directions(targets, boxes, limits, lenses=lenses, rng=rng)
    poses = np.full((n, 4, 4), np.nan)
    least, most = limits.distance_m
    # Estimated distances far beyond the limits are rejected without solving.
    possible = np.flatnonzero((distance > least / MAX_DISTANCE_ERROR) & (distance < most * MAX_DISTANCE_ERROR))
    for model, of_model in targets.take(possible).by_model():
        of_model = possible[of_model]
        hull = hull_of(model, targets.world_from_vehicle[of_model], targets.model_angles(model, of_model))
        for wide in (False, True):
            chosen = boxes.wide[of_model] == wide
            i = of_model[chosen]
            if not len(i):
                continue
            frame = partial(
                place_boxes,
                points_world=hull[chosen],
                corners=boxes.corners[i],
                cut=boxes.cut[i],
                kept=boxes.least_kept(limits.truncated_fraction[1])[i],
                roll=roll[i],
            )
            poses[i], distance[i] = size_cameras(
                targets.take(i),
                hull[chosen],
                lenses=lenses.take(i),
                pixels=boxes.pixels[i],
                measure="width" if wide else "height",
                azimuth=azimuth[i],
                elevation=elevation[i],
                roll=roll[i],
                frame=frame,
            )
    return poses, distance


def choose_directions(
    targets: Instances, boxes: TargetBoxes, limits: CameraSection, *, lenses: Intrinsics, rng: RowStreams
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Sample elevations, choose azimuths by how well the aspect ratio fits, and estimate the distance.

    Elevations are the configured ones, since an aspect ratio hardly tells them: a turret that a label leaves out weighs
    as much as 20 degrees.
    """
    n = len(targets)
    low, high = (math.radians(angle) for angle in limits.elevation_deg)
    azimuth = draw_azimuth(n * CAMERA_DIRECTIONS, rng=rng).reshape(n, CAMERA_DIRECTIONS)
    elevation = draw_elevation(n * CAMERA_DIRECTIONS, (low, high), rng=rng, uniform_in=limits.elevation_sampling)
    elevation = np.repeat(elevation.reshape(n, CAMERA_DIRECTIONS)[:, :1], CAMERA_DIRECTIONS, axis=1)
    axes = shell_axes(azimuth, elevation)[1]
    local = targets.corners() - targets.centers[:, None]
    # Explicit sums, which have the same bits on every processor.
    x, y, depth = (
        local[:, None, :, 0] * axes[..., None, 0, axis]
        + local[:, None, :, 1] * axes[..., None, 1, axis]
        + local[:, None, :, 2] * axes[..., None, 2, axis]
        for axis in range(3)
    )
    measured = np.where(boxes.wide[:, None], np.ptp(x, axis=2), np.ptp(y, axis=2))
    # Perspective changes the aspect ratio of near targets: apply it at about the wanted size.
    distance = measured * lenses.focal[..., 1:] / boxes.pixels[:, None]
    scale = 1.0 / np.maximum(distance[..., None] + depth, 0.1 * distance[..., None])
    misfit = log(np.ptp(x * scale, axis=2) / np.ptp(y * scale, axis=2)) - log(boxes.aspect)[:, None]
    across, down = boxes.cut_across[:, None], boxes.cut_down[:, None]
    # Where the frame cuts off the width, a target is longer than its box, and taller where it cuts off the height: as
    # much as `truncated_fraction` allows.
    longer = np.maximum(log(boxes.kept / (1.0 - TRUNCATION_MARGIN * limits.truncated_fraction[1])), 0.0)[:, None]
    misfit -= np.where(across, np.clip(misfit, 0.0, longer), 0.0)
    misfit -= np.where(down & ~across, np.clip(misfit, -longer, 0.0), 0.0)
    row, chosen = np.arange(n), choose_fitting(misfit, limits, boxes.choice)
    return azimuth[row, chosen], elevation[row, chosen], distance[row, chosen]


def choose_fitting(
    misfit: Float[np.ndarray, "n d"], limits: CameraSection, choice: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """Choose a direction for each row by the misfits of logarithmic aspect ratios, with numbers in [0, 1)."""
    exponent = -0.5 * (misfit / max(limits.like_spread / 2.0, MIN_ASPECT_TOLERANCE)) ** 2
    return choose(exp(exponent - exponent.max(axis=1, keepdims=True)), choice)


def companion_poses(
    likeness: Likeness,
    targets: Instances,
    others: Instances,
    boxes: TargetBoxes,
    *,
    number: Int[np.ndarray, " n"],
    lenses: Intrinsics,
    rng: RowStreams,
) -> Float[np.ndarray, "n 3"]:
    """Return places and headings on level ground at which companions fill the other boxes of the photographs.

    A companion is on the ray through its box's center. Its distance follows from the box's height, or in steep views,
    where a box shows length and width, from where the ray meets the ground.
    """
    photographs, limits = likeness.photographs, likeness.config
    poses = np.full((len(number), 3), np.nan)
    azimuth, elevation, distance = choose_directions(targets, boxes, limits.camera, lenses=lenses, rng=rng)
    uniform = rng.random((len(number) * CAMERA_DIRECTIONS,)).reshape(-1, CAMERA_DIRECTIONS)
    # Companions of an image have the same random numbers.
    yaw = 2.0 * math.pi * (uniform + GOLDEN_RATIO * number[:, None])
    has = np.flatnonzero(number < likeness.companion_counts(boxes.box))
    start = np.searchsorted(photographs.image, photographs.image[boxes.box])
    box, of_target = (start + number + (start + number >= boxes.box))[has], boxes.box[has]
    distance, yaw, lenses = distance[has], yaw[has], lenses.take(has)
    size, tall = (each.fleet.size[each.model[has]] for each in (others, targets))

    # Relative to the target's center, with the target where its box is.
    level = camera_pose(np.zeros((len(has), 3)), distance, azimuth[has], elevation[has])
    turn = turned(Cameras(lenses, level), photographs.center[of_target] * lenses.size).world_from_camera[:, :3, :3]
    ray = rotate(turn, lenses.pixel_directions((photographs.center[box] * lenses.size)[:, None]))[:, 0]
    ray /= np.sqrt((ray * ray).sum(axis=1, keepdims=True))
    by_height = distance * size[:, 2] / tall[:, 2] * photographs.height[of_target] / photographs.height[box]
    to_ground = (level[:, 2, 3] + (tall[:, 2] - size[:, 2]) / 2.0) / np.maximum(-ray[:, 2], MIN_RAY_FALL)
    steep = (elevation[has] > MIN_STEEP_RADIANS) & (ray[:, 2] < -MIN_RAY_FALL)
    away = np.where(steep, to_ground, by_height)[:, None] * ray

    sy, cy = (part[..., None] for part in sin_cos(yaw))
    x, y, z = np.moveaxis(BOX_CORNERS * (size[:, None] / 2.0), 2, 0)[:, :, None]
    corners = np.stack(np.broadcast_arrays(cy * x - sy * y, sy * x + cy * y, z), axis=-1) + away[:, None, None]
    right, down, ahead = np.moveaxis(corners @ turn[:, None], 3, 0)
    ahead = np.maximum(ahead, 0.1 * distance[:, None, None])
    aspect = np.ptp(right / ahead, axis=2) / np.ptp(down / ahead, axis=2)
    whole = ~photographs.cut[box].any(axis=1, keepdims=True)
    misfit = np.where(whole, log(aspect) - log(photographs.aspect[box])[:, None], 0.0)
    poses[has, 2] = yaw[np.arange(len(has)), choose_fitting(misfit, limits.camera, boxes.choice[has])]

    xy = level[:, :2, 3] + away[:, :2]
    length = np.maximum(hypot(xy[:, 0], xy[:, 1]), 1e-9)
    poses[has, :2] = xy * (np.clip(length, *limits.placement.companion_distance) / length)[:, None]
    return poses
