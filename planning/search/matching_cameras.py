"""Cameras that reproduce the boxes of photographs."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from hulldown.camera.framing import place_boxes
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import draw_azimuth, draw_elevation, shell_axes
from hulldown.geometry.portable import exp, log
from hulldown.planning.config.camera_section import CameraSection
from hulldown.planning.config.schema import Config
from hulldown.planning.search.instance_table import Instances, hull_of
from hulldown.planning.search.likeness import CUT, Wishes
from hulldown.planning.search.random_streams import Purpose, RandomStreams, RowStreams, choose
from hulldown.planning.search.sizing import sized_cameras

DIRECTIONS = 24  # candidates for each camera
LEAST_TOLERANCE = 0.03  # relative, of aspect ratios: no vehicle has exactly the sampled one
SLACK = 2.0  # largest factor by which estimated distances are wrong


def directions_of(draws: RandomStreams, image: Int[np.ndarray, " n"], attempt: Int[np.ndarray, " n"]) -> RowStreams:
    """Return the generator for the candidate directions of these tries."""
    tries = attempt[:, None] * DIRECTIONS + np.arange(DIRECTIONS)
    return RowStreams(draws, Purpose.DIRECTION, np.repeat(image, DIRECTIONS), tries.ravel())


def matching_cameras(
    targets: Instances,
    wishes: Wishes,
    config: Config,
    *,
    intrinsics: Intrinsics,
    roll: Float[np.ndarray, " n"],
    rng: RowStreams,
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, " n"]]:
    """Cameras that reproduce size and place of the photographs' boxes, and their distances; nan without one."""
    n = len(targets)
    azimuth, elevation, distance = chosen_directions(targets, wishes, config, intrinsics=intrinsics, rng=rng)
    poses = np.full((n, 4, 4), np.nan)
    least, most = config.camera.distance_m
    # Estimated distances far beyond the limits are rejected without solving.
    possible = np.flatnonzero((distance > least / SLACK) & (distance < most * SLACK))
    for model, of_model in targets.take(possible).by_model():
        of_model = possible[of_model]
        hull = hull_of(model, targets.world_from_vehicle[of_model], targets.model_angles(model, of_model))
        for wide in (False, True):
            chosen = wishes.wide[of_model] == wide
            i = of_model[chosen]
            if not len(i):
                continue
            framed = partial(
                place_boxes,
                points_world=hull[chosen],
                intrinsics=intrinsics.rows(i),
                corners=wishes.corners[i],
                cut=wishes.cut[i],
                kept=wishes.least_kept(config)[i],
                roll=roll[i],
            )
            poses[i], distance[i] = sized_cameras(
                targets.take(i),
                hull[chosen],
                intrinsics=intrinsics.rows(i),
                pixels=wishes.pixels[i],
                measure="width" if wide else "height",
                azimuth=azimuth[i],
                elevation=elevation[i],
                roll=roll[i],
                framed=framed,
            )
    return poses, distance


def chosen_directions(
    targets: Instances, wishes: Wishes, config: Config, *, intrinsics: Intrinsics, rng: RowStreams
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Sample elevations, choose azimuths by how well the aspect ratio fits, and estimate the distance.

    Elevations are the configured ones, since an aspect ratio hardly tells them: a turret that a label leaves out weighs
    as much as 20 degrees.
    """
    n, limits = len(targets), config.camera
    low, high = (math.radians(angle) for angle in limits.elevation_deg)
    azimuth = draw_azimuth(n * DIRECTIONS, rng=rng).reshape(n, DIRECTIONS)
    elevation = draw_elevation(n * DIRECTIONS, (low, high), rng=rng, uniform_in=limits.elevation_sampling)
    elevation = np.repeat(elevation.reshape(n, DIRECTIONS)[:, :1], DIRECTIONS, axis=1)
    axes = shell_axes(azimuth, elevation)[1]
    local = targets.corners() - targets.centers[:, None]
    x, y, depth = (sum(local[:, None, :, k] * axes[..., None, k, axis] for k in range(3)) for axis in range(3))
    measured = np.where(wishes.wide[:, None], np.ptp(x, axis=2), np.ptp(y, axis=2))
    # Perspective changes the aspect ratio of near targets: apply it at about the wanted size.
    distance = measured * intrinsics.focal[..., 1:] / wishes.pixels[:, None]
    scale = 1.0 / np.maximum(distance[..., None] + depth, 0.1 * distance[..., None])
    misfit = log(np.ptp(x * scale, axis=2) / np.ptp(y * scale, axis=2)) - log(wishes.aspect)[:, None]
    across, down = (wishes.cut[:, :2] | wishes.cut[:, 2:]).T[..., None]
    # Where the frame cuts off the width, a target is longer than its box, and taller where it cuts off the height: as
    # much as `truncated_fraction` allows.
    longer = np.maximum(log(wishes.kept / (1.0 - CUT * limits.truncated_fraction[1])), 0.0)[:, None]
    misfit -= np.where(across, np.clip(misfit, 0.0, longer), 0.0)
    misfit -= np.where(down & ~across, np.clip(misfit, -longer, 0.0), 0.0)
    row, chosen = np.arange(n), fitting(misfit, limits, wishes.choice)
    return azimuth[row, chosen], elevation[row, chosen], distance[row, chosen]


def fitting(
    misfit: Float[np.ndarray, "n d"], limits: CameraSection, choice: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """Choose a direction for each row by the misfits of logarithmic aspect ratios, with numbers in [0, 1)."""
    exponent = -0.5 * (misfit / max(limits.like_spread / 2.0, LEAST_TOLERANCE)) ** 2
    return choose(exp(exponent - exponent.max(axis=1, keepdims=True)), choice)
