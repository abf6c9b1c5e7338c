"""Cameras for tries, before they're checked: lens, direction, and the distance at which the target has its size.

References
----------
Paper, section 2.1.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import frame_target, turned
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose, draw_azimuth, draw_elevation, shell_axes, shell_place
from hulldown.geometry.columns import take
from hulldown.geometry.transforms import rigid
from hulldown.plan.config.schema import Config
from hulldown.plan.row import rounded
from hulldown.planning.search.block import Block
from hulldown.planning.search.given import Given
from hulldown.planning.search.instance_table import Instances, hull_of
from hulldown.planning.search.likeness import TargetBoxes
from hulldown.planning.search.photo_cameras import candidate_directions, match_cameras
from hulldown.planning.search.random_streams import Purpose, RowStreams, between
from hulldown.planning.search.sizing import image_size, size_cameras

MIN_CAMERA_DISTANCE_M = 1e-6  # from a target's center to a given camera, which keeps the direction defined


class CameraRule(IntEnum):
    """What determines the place of a try's camera."""

    GIVEN = 0  # the user; the camera is then turned to frame the target
    EQUATION = 1  # the paper's distance; the camera is then turned to frame the target
    SIZE = 2  # a size of the target's box, with the target in frame
    PHOTOGRAPH = 3  # a photograph's box, which the target's box reproduces


@dataclass(frozen=True, eq=False, slots=True)
class CameraTries:
    """n tries of cameras; row i of every field is try i."""

    targets: Instances
    others: Instances  # the vehicles beside the targets, by `Instances.row`
    given: Given  # what the user's poses give
    image: Int[np.ndarray, " n"]  # index of each try's image
    attempt: Int[np.ndarray, " n"]  # number of the try among those of its image
    quarter: Int[np.ndarray, " n"]  # 0 to 3: how many quarters of an image's tries are used up; see `likeness`
    visibility_m: Float[np.ndarray, " n"]  # nan in clear air


@dataclass(frozen=True, eq=False, slots=True)
class CameraCandidates:
    """Cameras of n tries before they're checked."""

    rule: UInt8[np.ndarray, " n"]  # a `CameraRule`
    lenses: Intrinsics  # one for all, or n
    roll: Float[np.ndarray, " n"]  # about the optical axis, radians
    distance: Float[np.ndarray, " n"]  # meters from the target's center; nan: no distance gives the size
    # level and aimed at the target's center by the first two rules, which are framed later; final by the others
    world_from_camera: Float[np.ndarray, "n 4 4"]
    fraction: Float[np.ndarray, " n"]  # share of the image that the target should fill
    boxes: TargetBoxes | None  # the boxes of photographs; None without photographs

    def cameras(self, rows: Int[np.ndarray, " k"]) -> Cameras:
        """Return the cameras of tries that have one."""
        return Cameras(self.lenses.take(rows), self.world_from_camera[rows])

    @property
    def is_framed(self) -> Bool[np.ndarray, " n"]:
        """Whether the pose is final."""
        return self.rule >= CameraRule.SIZE


def sample_cameras(block: Block, tries: CameraTries) -> CameraCandidates:
    """Sample lenses and directions, and find the place of each camera by its rule."""
    config, draws, targets, given = block.config, block.draws, tries.targets, tries.given
    n, limits, measure = len(tries.image), config.camera, config.camera.size_measure
    rng = RowStreams(draws, Purpose.CAMERA, tries.image, tries.attempt)
    lens, size, factor = rng.random((n, 3)).T
    azimuth = draw_azimuth(n, rng=rng)
    low, high = (math.radians(angle) for angle in limits.elevation_deg)
    elevation = draw_elevation(n, (low, high), rng=rng, uniform_in=limits.elevation_sampling)
    turn = rng.random((n, 1))[:, 0]
    # All images of a sequence have the lens and the roll of its first.
    of_sequence = draws.uniform(Purpose.SEQUENCE, np.maximum(given.sequence, 0), 0, count=2)
    lens = np.where(given.in_sequence, of_sequence[:, 0], lens)
    turn = np.where(given.in_sequence, of_sequence[:, 1], turn)
    lenses, fraction = sample_lenses(config, lens), between(*limits.target_fraction, size)
    roll = np.radians(between(*limits.roll_deg, turn))

    rule = np.where(given.has_camera, CameraRule.GIVEN, CameraRule.EQUATION if measure == "paper" else CameraRule.SIZE)
    boxes = None
    if block.likeness is not None:
        boxes = block.likeness.target_boxes(
            draws, targets, image=tries.image, attempt=tries.attempt, quarter=tries.quarter
        )
        rule[~given.has_camera & ~given.has_look_at & boxes.has_box] = CameraRule.PHOTOGRAPH

    distance, poses = np.full(n, np.nan), np.full((n, 4, 4), np.nan)
    i = np.flatnonzero(rule == CameraRule.GIVEN)
    away, azimuth[i], elevation[i] = shell_place(given.camera[i] - targets.take(i).centers)
    distance[i] = np.maximum(away, MIN_CAMERA_DISTANCE_M)
    i = np.flatnonzero(rule == CameraRule.EQUATION)
    smallest = targets.fleet.size.min(axis=1)[targets.model[i]]
    distance[i] = lenses.take(i).distance_for(smallest, fraction[i]) * between(*limits.distance_factor, factor[i])
    i = np.flatnonzero(rule <= CameraRule.EQUATION)
    poses[i] = camera_pose(targets.take(i).centers, distance[i], azimuth[i], elevation[i])
    if measure != "paper":
        for model, of_model in targets.by_model():
            i = of_model[rule[of_model] == CameraRule.SIZE]
            poses[i], distance[i] = size_cameras(
                targets.take(i),
                hull_of(model, targets.world_from_vehicle[i], targets.model_angles(model, i)),
                lenses=lenses.take(i),
                pixels=fraction[i] * image_size(measure, config.render),
                measure=measure,
                azimuth=azimuth[i],
                elevation=elevation[i],
                roll=roll[i],
                frame=partial(frame_targets, block, tries, rows=i, roll=roll[i]),
            )
    if boxes is not None:
        i = np.flatnonzero(rule == CameraRule.PHOTOGRAPH)
        poses[i], distance[i] = match_cameras(
            targets.take(i),
            take(boxes, i),
            limits,
            lenses=lenses.take(i),
            roll=roll[i],
            rng=candidate_directions(draws, tries.image[i], tries.attempt[i]),
        )
    return CameraCandidates(rule.astype(np.uint8), lenses, roll, distance, poses, fraction, boxes)


def frame_targets(
    block: Block, tries: CameraTries, cameras: Cameras, *, rows: Int[np.ndarray, " k"], roll: Float[np.ndarray, " k"]
) -> Cameras:
    """Turn the cameras of some tries so that their targets are in frame, or to the points that users give."""
    limits, given = block.config.camera, take(tries.given, rows)
    framed = frame_target(
        cameras,
        tries.targets.take(rows).corners(),
        roll=roll,
        rng=RowStreams(block.draws, Purpose.FRAMING, tries.image[rows], tries.attempt[rows]),
        spread=limits.framing,
        truncated=limits.truncated_fraction,
    )
    at = np.flatnonzero(given.has_look_at)
    aimed = cameras.take(at)
    axes = shell_axes(*shell_place(aimed.position - given.look_at[at])[1:])[1]
    aimed = turned(aimed.at_poses(rigid(axes, aimed.position)), aimed.lenses.center, roll[at])
    framed.world_from_camera[at] = aimed.world_from_camera
    return framed


def sample_lenses(config: Config, uniform: Float[np.ndarray, " n"]) -> Intrinsics:
    """Return the calibrated camera, or n cameras with fields of view in proportion to numbers in [0, 1)."""
    return config.intrinsics(rounded("fov_x_deg", between(*config.camera.fov_x_deg, uniform)))
