"""Cameras for tries, and views of their targets within the config's limits, one per row (paper, section 2.1.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.annotate.boxes import Boxes
from hulldown.annotate.silhouettes import show_pixels
from hulldown.annotate.visibility import visible_fraction
from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import frame_target, pan_to_pixel
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose, draw_azimuth, draw_elevation, shell_axes, shell_place
from hulldown.camera.weather.extinction import air_contrast
from hulldown.geometry.columns import put_rows, take
from hulldown.geometry.transforms import rigid_matrix
from hulldown.placement.rejection import Rejection
from hulldown.plan.config.schema import Config
from hulldown.plan.row import round_field
from hulldown.planning.search.budget import Given
from hulldown.planning.search.instance_table import (
    Instances,
    filled_fraction,
    image_size,
    posed_hull,
    size_cameras,
    vehicle_boxes,
)
from hulldown.planning.search.likeness import TargetBoxes, candidate_directions, match_cameras
from hulldown.planning.search.random_streams import Purpose, RowStreams, scale_uniform
from hulldown.planning.search.stage import Site
from hulldown.planning.search.tables import Block, Views, no_views

MIN_CAMERA_DISTANCE_M = 1e-6  # from a target's center to a given camera, which keeps the direction defined
SIZE_TOLERANCE = 1e-9  # relative, of solved sizes: the solver and the box's projection round differently
SURELY_VISIBLE_PX2 = 1000.0  # visible area of a box above which some pixel center surely shows the target


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
    lenses, fraction = sample_lenses(config, lens), scale_uniform(*limits.target_fraction, size)
    roll = np.radians(scale_uniform(*limits.roll_deg, turn))

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
    distance[i] = lenses.take(i).target_distance(smallest, fraction[i]) * scale_uniform(
        *limits.distance_factor, factor[i]
    )
    i = np.flatnonzero(rule <= CameraRule.EQUATION)
    poses[i] = camera_pose(targets.take(i).centers, distance[i], azimuth[i], elevation[i])
    if measure != "paper":
        for model, of_model in targets.by_model():
            i = of_model[rule[of_model] == CameraRule.SIZE]
            poses[i], distance[i] = size_cameras(
                targets.take(i),
                posed_hull(model, targets.world_from_vehicle[i], targets.model_angles(model, i)),
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
        tries.targets.take(rows).box_corners(),
        roll=roll,
        rng=RowStreams(block.draws, Purpose.FRAMING, tries.image[rows], tries.attempt[rows]),
        spread=limits.framing,
        truncated=limits.truncated_fraction,
    )
    at = np.flatnonzero(given.has_look_at)
    aimed = cameras.take(at)
    axes = shell_axes(*shell_place(aimed.position - given.look_at[at])[1:])[1]
    aimed = pan_to_pixel(aimed.at_poses(rigid_matrix(axes, aimed.position)), aimed.lenses.center, roll[at])
    framed.world_from_camera[at] = aimed.world_from_camera
    return framed


def sample_lenses(config: Config, uniform: Float[np.ndarray, " n"]) -> Intrinsics:
    """Return the calibrated camera, or n cameras with fields of view in proportion to numbers in [0, 1)."""
    return config.intrinsics(round_field("fov_x_deg", scale_uniform(*config.camera.fov_x_deg, uniform)))


def try_cameras(block: Block, tries: CameraTries) -> Views:
    """Make cameras, and check them against the config's limits.

    Checks are in the order of their cost, and each is of the rows that passed those before. Limits of distance and size
    don't apply to given cameras.
    """
    site, limits, config, candidates = block.site, block.config.camera, block.config, sample_cameras(block, tries)
    n = len(tries.image)
    views = no_views(n)
    views.fov_x_deg[:] = round_field("fov_x_deg", candidates.lenses.fov_x_deg)
    if (boxes := candidates.boxes) is not None:
        views.sampled[:] = np.where(tries.given.has_camera | tries.given.has_look_at, -1, boxes.sampled)
        views.followed[:] = np.where(candidates.rule == CameraRule.PHOTOGRAPH, boxes.box, -1)

    def passed() -> Int[np.ndarray, " k"]:
        return np.flatnonzero(views.rejection == Rejection.NONE)

    views.rejection[:] = reject_distance(candidates, tries.visibility_m, config)
    rows = passed()
    views.rejection[rows] = site.camera_room.reject_places(
        candidates.world_from_camera[rows, :3, 3],
        ground_clearance=limits.ground_clearance,
        obstacle_clearance=limits.obstacle_clearance,
        vehicles=[*tries.targets.take(rows).posed_vehicles(), *tries.others.repeat_rows(rows)[0].posed_vehicles()],
    )

    rows = passed()
    cameras, unframed = candidates.cameras(rows), np.flatnonzero(~candidates.is_framed[rows])
    i = rows[unframed]
    framed = frame_targets(block, tries, cameras.take(unframed), rows=i, roll=candidates.roll[i])
    cameras.world_from_camera[unframed] = framed.world_from_camera
    # Labels follow from rounded poses.
    cameras = cameras.at_poses(round_field("world_from_camera", cameras.world_from_camera))
    targets = tries.targets.take(rows)
    views.world_from_camera[rows] = cameras.world_from_camera
    views.air_contrast[rows] = air_contrasts(targets, cameras, tries.visibility_m[rows])
    put_rows(views.boxes, rows, vehicle_boxes(targets, cameras))
    views.rejection[rows] = reject_box(take(views.boxes, rows), candidates, rows, config)

    def visible() -> tuple[Instances, Instances, Cameras]:
        """Return targets, others, and cameras of these rows."""
        cameras = candidates.lenses.take(rows), views.world_from_camera[rows]
        return tries.targets.take(rows), tries.others.repeat_rows(rows)[0], Cameras(*cameras)

    rows = passed()
    views.visible_fraction[rows] = visible_shares(site, *visible(), rays=limits.visibility_rays)
    views.rejection[rows] = reject_outside(
        views.visible_fraction[rows], *limits.visible_fraction, below=Rejection.HIDDEN, above=Rejection.EXPOSED
    )

    rows = passed()
    rows = rows[views.visible_fraction[rows] * views.boxes.xywh[rows, 2:].prod(axis=1) < SURELY_VISIBLE_PX2]
    shown = pixels_shown(site, *visible(), xywh=views.boxes.xywh[rows])
    views.rejection[rows[~shown]] = Rejection.HIDDEN
    return views


def reject_distance(
    candidates: CameraCandidates, visibility_m: Float[np.ndarray, " n"], config: Config
) -> UInt8[np.ndarray, " n"]:
    """Return rejections of candidates by their distance, and by the contrast at that distance."""
    distance, (low, high) = candidates.distance, config.camera.distance_m
    faint = reject_outside(air_contrast(visibility_m, distance), config.weather.min_contrast, below=Rejection.FAINT)
    apart = reject_outside(distance, low, high, below=Rejection.DISTANCE, above=Rejection.DISTANCE)
    rejection = np.where((candidates.rule != CameraRule.GIVEN) & (apart != Rejection.NONE), apart, faint)
    rejection[np.isnan(distance)] = Rejection.SIZE
    return rejection


def reject_box(
    boxes: Boxes, candidates: CameraCandidates, rows: Int[np.ndarray, " k"], config: Config
) -> UInt8[np.ndarray, " k"]:
    """Return rejections of these rows of the candidates by their targets' boxes."""
    limits, rule = config.camera, candidates.rule[rows]
    # A target outside the frame has the box nan, which is too small.
    small = reject_outside(boxes.xywh[:, 2:].min(axis=1), limits.min_box_px, below=Rejection.SMALL)
    cut = reject_outside(
        boxes.truncated_fraction, *limits.truncated_fraction, below=Rejection.TRUNCATION, above=Rejection.TRUNCATION
    )
    rejection = np.where(cut, cut, small)
    # Sizes can miss if part of the target is nearer than the near plane.
    if limits.size_measure != "paper":
        filled = filled_fraction(boxes.amodal, limits.size_measure, config.render)
        rejection[(rule == CameraRule.SIZE) & ~is_size(filled, candidates.fraction[rows])] = Rejection.SIZE
    if candidates.boxes is not None:
        wanted = take(candidates.boxes, rows)
        width, height = boxes.amodal[:, 2:].T
        size = np.where(wanted.wide, width, height)
        rejection[(rule == CameraRule.PHOTOGRAPH) & ~is_size(size, wanted.pixels)] = Rejection.SIZE
    return rejection


def is_size(size: Float[np.ndarray, " k"], wanted: Float[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    """Return whether sizes are the wanted ones; nan isn't."""
    return np.abs(size - wanted) <= SIZE_TOLERANCE * wanted


def views_of_others(
    site: Site,
    subjects: Instances,
    others: Instances,
    *,
    views: Views,
    cameras: Cameras,
    visibility_m: Float[np.ndarray, " n"],
    config: Config,
) -> tuple[Views, Bool[np.ndarray, " n"]]:
    """Return views of vehicles that aren't targets, and whether those with a class cover the center of any pixel.

    `views`: the cameras' views of their targets.
    Row i of `subjects` and of `others` is camera i; `visibility_m` is nan in clear air.
    """
    seen = replace(
        views,
        boxes=vehicle_boxes(subjects, cameras),
        visible_fraction=visible_shares(site, subjects, others, cameras, rays=config.camera.visibility_rays),
        air_contrast=air_contrasts(subjects, cameras, visibility_m),
    )
    named, pixels = np.flatnonzero(subjects.fleet.classed[subjects.model]), np.zeros(len(subjects), dtype=bool)
    beside = others.repeat_rows(named)[0]
    shown = pixels_shown(site, subjects.take(named), beside, cameras.take(named), xywh=seen.boxes.xywh[named])
    pixels[named] = shown
    return seen, pixels


def air_contrasts(
    instances: Instances, cameras: Cameras, visibility_m: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the share of each vehicle's contrast after haze, between the camera and the center of its box."""
    away = instances.centers - cameras.position
    return air_contrast(visibility_m, np.sqrt((away * away).sum(axis=1)))


def visible_shares(
    site: Site, subjects: Instances, others: Instances, cameras: Cameras, *, rays: int
) -> Float[np.ndarray, " n"]:
    """Visible share of the outline of each camera's subject; 0 for a subject outside the frame."""
    if not len(cameras):
        return np.zeros(0)
    seen = visible_fraction(
        subjects.posed_vehicles(), cameras, world=site.world.with_vehicles(others.posed_vehicles()), rays=rays
    )
    # nan is a vehicle that no ray met, since it is thinner than the distance of the rays.
    return np.nan_to_num(seen.fraction)


def pixels_shown(
    site: Site, subjects: Instances, others: Instances, cameras: Cameras, *, xywh: Float[np.ndarray, "n 4"]
) -> Bool[np.ndarray, " n"]:
    """Tell which of the cameras' subjects, with these boxes, cover any pixel's center: their masks aren't empty."""
    framed = np.flatnonzero(~np.isnan(xywh[:, 0]))
    shown, world = (
        np.zeros(len(cameras), dtype=bool),
        site.world.with_vehicles(others.repeat_rows(framed)[0].posed_vehicles()),
    )
    subject, box = subjects.take(framed).posed_vehicles(), round_field("bbox", xywh[framed])
    shown[framed] = show_pixels(subject, cameras.take(framed), xywh=box, world=world)
    return shown


def reject_outside(
    values: Float[np.ndarray, " n"],
    low: float,
    high: float = math.inf,
    *,
    below: Rejection,
    above: Rejection = Rejection.NONE,
) -> UInt8[np.ndarray, " n"]:
    """Return the rejection of each value below or above these inclusive limits; nan is below."""
    return np.where(values >= low, np.where(values <= high, Rejection.NONE, above), below).astype(np.uint8)
