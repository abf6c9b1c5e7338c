"""Cameras for tries, and views of their targets within the config's limits, one per row (paper, section 2.1.6)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.annotate.boxes import Boxes
from hulldown.annotate.silhouettes import visible_subject_mask
from hulldown.annotate.visibility import measure_visibility
from hulldown.base.columns import put_rows, take
from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import pan_center_to_pixel, turn_cameras_to_targets
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose, outward_and_camera_axes, sample_azimuths, sample_elevations, shell_coordinates
from hulldown.geometry.transforms import rigid_matrix
from hulldown.plan.config.scene_sections import CameraSection, RenderSection
from hulldown.plan.rejection import Rejection
from hulldown.plan.row import round_field
from hulldown.planning.search.instance_table import (
    Instances,
    filled_fraction,
    fit_cameras_to_sizes,
    image_size_by_measure,
    posed_hull_vertices,
    vehicle_boxes,
)
from hulldown.planning.search.likeness import Following, direction_streams, fit_cameras_to_boxes
from hulldown.planning.search.random_streams import Purpose, RowStreams, scale_uniform
from hulldown.planning.search.stage import Site
from hulldown.planning.search.tables import Block, CameraCandidates, CameraDraws, CameraRule, CameraTries, Views, nan_views
from hulldown.weather.extinction import air_contrast

MIN_CAMERA_DISTANCE_M = 1e-6  # from a target's center to a given camera, so that the direction is defined
SIZE_TOLERANCE_SHARE = 1e-9  # of solved sizes: the solver and the box's projection round differently
SURELY_VISIBLE_PX2 = 1000.0  # if this much of a box is visible, some pixel center shows the target


def sample_camera_candidates(block: Block, tries: CameraTries) -> CameraCandidates:
    """Draw the cameras of tries, and place each by its rule."""
    drawn, n = sample_camera_draws(block, tries), len(tries.image)
    by_default = CameraRule.EQUATION if block.config.camera.size_measure == "paper" else CameraRule.SIZE
    rule = np.where(tries.given.has_camera, CameraRule.GIVEN, by_default)
    if drawn.boxes is not None:
        followed = drawn.boxes.following == Following.PHOTOGRAPH
        rule[followed & ~tries.given.has_view] = CameraRule.PHOTOGRAPH
    poses, distance = np.zeros((n, 4, 4)), np.zeros(n)
    for place_cameras, of_rule in (
        (place_given_cameras, CameraRule.GIVEN),
        (place_cameras_by_equation, CameraRule.EQUATION),
        (place_cameras_by_size, CameraRule.SIZE),
        (place_cameras_by_photograph, CameraRule.PHOTOGRAPH),
    ):
        rows = np.flatnonzero(rule == of_rule)
        if len(rows):
            poses[rows], distance[rows] = place_cameras(block, tries, drawn, rows)
    return CameraCandidates(drawn, rule.astype(np.uint8), poses, distance, ~np.isnan(distance))


def sample_camera_draws(block: Block, tries: CameraTries) -> CameraDraws:
    """Draw lenses, directions, and sizes of tries within the config's limits."""
    config, draws, given, n = block.config, block.draws, tries.given, len(tries.image)
    limits = config.camera
    rng = RowStreams(draws, Purpose.CAMERA, tries.image, tries.attempt)
    lens, size, factor = rng.random((n, 3)).T
    azimuth = sample_azimuths(n, rng=rng)
    low, high = (math.radians(angle) for angle in limits.elevation_deg)
    elevation = sample_elevations(n, (low, high), rng=rng, uniform_in=limits.elevation_sampling)
    roll = rng.random((n, 1))[:, 0]
    # All images of a sequence have the lens and the roll of its first.
    of_sequence = draws.uniform(Purpose.SEQUENCE, given.first, 0, count=2)
    lens, roll = np.where(given.in_sequence, of_sequence.T, [lens, roll])
    boxes = None
    if block.likeness is not None:
        boxes = block.likeness.sample_target_boxes(
            draws, tries.targets, image=tries.image, attempt=tries.attempt, quarter=tries.quarter
        )
    return CameraDraws(
        lenses=sample_lenses(config.intrinsics, limits.fov_x_deg, lens),
        azimuth=azimuth,
        elevation=elevation,
        roll=np.radians(scale_uniform(*limits.roll_deg, roll)),
        fraction=scale_uniform(*limits.target_fraction, size),
        factor=scale_uniform(*limits.distance_factor, factor),
        boxes=boxes,
    )


def sample_lenses(
    make: Callable[[Float[np.ndarray, " n"]], Intrinsics], fov_x_deg: tuple[float, float], uniform: Float[np.ndarray, " n"]
) -> Intrinsics:
    """Return lenses with fields of view in proportion to numbers in [0, 1); `make` is `Config.intrinsics`."""
    return make(round_field("fov_x_deg", scale_uniform(*fov_x_deg, uniform)))


# The places of cameras by a rule: poses and distances from targets' centers of these rows of the tries.
PlacedCameras: TypeAlias = tuple[Float[np.ndarray, "k 4 4"], Float[np.ndarray, " k"]]


def place_given_cameras(block: Block, tries: CameraTries, drawn: CameraDraws, rows: Int[np.ndarray, " k"]) -> PlacedCameras:
    """Place cameras where users give them, level and toward the targets' centers."""
    centers = tries.targets.take(rows).centers_in_world
    away, azimuth, elevation = shell_coordinates(tries.given.camera[rows] - centers)
    distance = np.maximum(away, MIN_CAMERA_DISTANCE_M)
    return camera_pose(centers, distance, azimuth, elevation), distance


def place_cameras_by_equation(
    block: Block, tries: CameraTries, drawn: CameraDraws, rows: Int[np.ndarray, " k"]
) -> PlacedCameras:
    """Place cameras at the paper's distance."""
    targets = tries.targets.take(rows)
    smallest = targets.fleet.size.min(axis=1)[targets.model]
    distance = drawn.lenses.take(rows).target_distance(smallest, drawn.fraction[rows]) * drawn.factor[rows]
    return camera_pose(targets.centers_in_world, distance, drawn.azimuth[rows], drawn.elevation[rows]), distance


def place_cameras_by_size(block: Block, tries: CameraTries, drawn: CameraDraws, rows: Int[np.ndarray, " k"]) -> PlacedCameras:
    """Frame targets at distances where their boxes have the drawn size; nan without such a distance."""
    measure = block.config.camera.size_measure
    assert measure != "paper"
    pixels = drawn.fraction * image_size_by_measure(measure, block.config.render)
    poses, distance = np.zeros((len(rows), 4, 4)), np.zeros(len(rows))
    for model, of_model in tries.targets.take(rows).indices_by_model():
        i = rows[of_model]
        targets = tries.targets.take(i)
        poses[of_model], distance[of_model] = fit_cameras_to_sizes(
            targets,
            posed_hull_vertices(model, targets.world_from_vehicle, targets.model_angles(model, np.arange(len(i)))),
            lenses=drawn.lenses.take(i),
            pixels=pixels[i],
            measure=measure,
            azimuth=drawn.azimuth[i],
            elevation=drawn.elevation[i],
            roll=drawn.roll[i],
            frame=partial(frame_or_aim_cameras, block, tries, rows=i, roll=drawn.roll[i]),
        )
    return poses, distance


def place_cameras_by_photograph(
    block: Block, tries: CameraTries, drawn: CameraDraws, rows: Int[np.ndarray, " k"]
) -> PlacedCameras:
    """Place cameras so that targets reproduce photographs' boxes; nan where no distance does."""
    assert drawn.boxes is not None
    return fit_cameras_to_boxes(
        tries.targets.take(rows),
        take(drawn.boxes, rows),
        block.config.camera,
        lenses=drawn.lenses.take(rows),
        roll=drawn.roll[rows],
        rng=direction_streams(block.draws, tries.image[rows], tries.attempt[rows]),
    )


def frame_or_aim_cameras(
    block: Block, tries: CameraTries, cameras: Cameras, *, rows: Int[np.ndarray, " k"], roll: Float[np.ndarray, " k"]
) -> Cameras:
    """Turn the cameras of some tries so that their targets are in frame, or to the points that users give."""
    limits, given = block.config.camera, take(tries.given, rows)
    framed = turn_cameras_to_targets(
        cameras,
        tries.targets.take(rows).part_box_corners(),
        roll=roll,
        rng=RowStreams(block.draws, Purpose.FRAMING, tries.image[rows], tries.attempt[rows]),
        spread=limits.framing,
        truncated=limits.truncated_fraction,
    )
    at = np.flatnonzero(given.has_look_at)
    aimed = cameras.take(at)
    axes = outward_and_camera_axes(*shell_coordinates(aimed.position - given.look_at[at])[1:])[1]
    aimed = pan_center_to_pixel(aimed.with_poses(rigid_matrix(axes, aimed.position)), aimed.lenses.center, roll[at])
    framed.world_from_camera[at] = aimed.world_from_camera
    return framed


def views_of_camera_tries(block: Block, tries: CameraTries) -> Views:
    """Make cameras, and check them against the config's limits, the cheapest first."""
    limits, candidates, views = block.config.camera, sample_camera_candidates(block, tries), nan_views(len(tries.image))
    views.fov_x_deg[:] = round_field("fov_x_deg", candidates.drawn.lenses.fov_x_deg)
    if (boxes := candidates.drawn.boxes) is not None:
        views.sampled[:], views.followed[:] = boxes.sampled, boxes.box
        views.following[:] = np.where(tries.given.has_view, Following.RANGES, boxes.following)

    contrast = block.config.weather.min_contrast
    views.rejection[:] = distance_rejections(candidates, tries.visibility_m, limits.distance_m, min_contrast=contrast)
    rows = views.accepted_rows
    views.rejection[rows] = camera_place_rejections(block.site, tries, candidates, limits, rows)
    rows = views.accepted_rows
    cameras, targets = final_cameras(block, tries, candidates, rows), tries.targets.take(rows)
    views.world_from_camera[rows] = cameras.world_from_camera
    views.air_contrast[rows] = vehicle_contrasts_after_haze(targets, cameras, tries.visibility_m[rows])
    put_rows(views.boxes, rows, vehicle_boxes(targets, cameras))
    views.rejection[rows] = box_rejections(take(views.boxes, rows), candidates, rows, limits, image=block.config.render)

    def scenes(rows: Int[np.ndarray, " k"]) -> tuple[Site, Instances, Instances, Cameras]:
        """Return the site, and targets, others, and cameras of these rows."""
        cameras = Cameras(candidates.drawn.lenses.take(rows), views.world_from_camera[rows])
        return block.site, tries.targets.take(rows).in_own_rows(), tries.others.take_rows(rows), cameras

    rows = views.accepted_rows
    views.visible_fraction[rows] = visible_shares(*scenes(rows), rays=limits.visibility_rays)
    views.rejection[rows] = limit_rejections(
        views.visible_fraction[rows], *limits.visible_fraction, below=Rejection.HIDDEN, above=Rejection.EXPOSED
    )
    rows = views.accepted_rows
    rows = rows[views.visible_fraction[rows] * views.boxes.xywh[rows, 2:].prod(axis=1) < SURELY_VISIBLE_PX2]
    shown = visible_vehicle_mask(*scenes(rows), xywh=views.boxes.xywh[rows])
    views.rejection[rows[~shown]] = Rejection.HIDDEN
    return views


def distance_rejections(
    candidates: CameraCandidates, visibility_m: Float[np.ndarray, " n"], distance_m: tuple[float, float], *, min_contrast: float
) -> UInt8[np.ndarray, " n"]:
    """Reject candidates by their distance, unless it's given, and by the contrast at that distance."""
    distance = candidates.distance
    faint = limit_rejections(air_contrast(visibility_m, distance), min_contrast, below=Rejection.FAINT)
    apart = limit_rejections(distance, *distance_m, below=Rejection.DISTANCE, above=Rejection.DISTANCE)
    rejection = np.where((candidates.rule != CameraRule.GIVEN) & (apart != Rejection.NONE), apart, faint)
    return np.where(candidates.has_distance, rejection, Rejection.SIZE)


def camera_place_rejections(
    site: Site, tries: CameraTries, candidates: CameraCandidates, limits: CameraSection, rows: Int[np.ndarray, " k"]
) -> UInt8[np.ndarray, " k"]:
    """Reject cameras of these rows that are too close to something."""
    beside = tries.targets.take(rows).in_own_rows(), tries.others.take_rows(rows)
    return site.camera_room.clearance_rejections(
        candidates.world_from_camera[rows, :3, 3],
        ground_clearance=limits.ground_clearance,
        obstacle_clearance=limits.obstacle_clearance,
        vehicles=[vehicle for each in beside for vehicle in each.posed_vehicles()],
    )


def final_cameras(block: Block, tries: CameraTries, candidates: CameraCandidates, rows: Int[np.ndarray, " k"]) -> Cameras:
    """Return the final cameras of these rows, rounded, since labels follow from rounded poses."""
    cameras, unframed = candidates.cameras(rows), np.flatnonzero(~candidates.is_framed[rows])
    i = rows[unframed]
    framed = frame_or_aim_cameras(block, tries, cameras.take(unframed), rows=i, roll=candidates.drawn.roll[i])
    cameras.world_from_camera[unframed] = framed.world_from_camera
    return cameras.with_poses(round_field("world_from_camera", cameras.world_from_camera))


def box_rejections(
    boxes: Boxes, candidates: CameraCandidates, rows: Int[np.ndarray, " k"], limits: CameraSection, *, image: RenderSection
) -> UInt8[np.ndarray, " k"]:
    """Reject these rows by their targets' boxes; limits of size don't apply to given cameras."""
    rule = candidates.rule[rows]
    # A target outside the frame has the box nan, which is too small.
    small = limit_rejections(boxes.xywh[:, 2:].min(axis=1), limits.min_box_px, below=Rejection.SMALL)
    cut = limit_rejections(
        boxes.truncated_fraction, *limits.truncated_fraction, below=Rejection.TRUNCATION, above=Rejection.TRUNCATION
    )
    rejection = np.where(cut, cut, small)
    if limits.size_measure != "paper":
        filled = filled_fraction(boxes.amodal, limits.size_measure, image)
        rejection[(rule == CameraRule.SIZE) & ~wanted_size_mask(filled, candidates.drawn.fraction[rows])] = Rejection.SIZE
    if candidates.drawn.boxes is not None:
        wanted = take(candidates.drawn.boxes, rows)
        width, height = boxes.amodal[:, 2:].T
        size = np.where(wanted.wide, width, height)
        rejection[(rule == CameraRule.PHOTOGRAPH) & ~wanted_size_mask(size, wanted.pixels)] = Rejection.SIZE
    return rejection


def wanted_size_mask(size: Float[np.ndarray, " k"], wanted: Float[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    """Return whether sizes are the wanted ones; false for nan."""
    return np.abs(size - wanted) <= SIZE_TOLERANCE_SHARE * wanted


def views_of_extras_and_shown_mask(
    site: Site,
    subjects: Instances,
    others: Instances,
    *,
    views: Views,
    cameras: Cameras,
    visibility_m: Float[np.ndarray, " n"],
    rays: int,
) -> tuple[Views, Bool[np.ndarray, " n"]]:
    """Return views of vehicles that aren't targets, row i by camera i, and whether those with a class cover a pixel."""
    seen = replace(
        views,
        boxes=vehicle_boxes(subjects, cameras),
        visible_fraction=visible_shares(site, subjects, others, cameras, rays=rays),
        air_contrast=vehicle_contrasts_after_haze(subjects, cameras, visibility_m),
    )
    named, pixels = np.flatnonzero(subjects.fleet.classed[subjects.model]), np.zeros(len(subjects), dtype=bool)
    beside, own = others.take_rows(named), subjects.take(named).in_own_rows()
    shown = visible_vehicle_mask(site, own, beside, cameras.take(named), xywh=seen.boxes.xywh[named])
    pixels[named] = shown
    return seen, pixels


def vehicle_contrasts_after_haze(
    instances: Instances, cameras: Cameras, visibility_m: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the share of each vehicle's contrast after haze, between the camera and the center of its box."""
    away = instances.centers_in_world - cameras.position
    return air_contrast(visibility_m, np.sqrt((away * away).sum(axis=1)))


def visible_shares(
    site: Site, subjects: Instances, others: Instances, cameras: Cameras, *, rays: int
) -> Float[np.ndarray, " n"]:
    """Return the visible share of each subject's outline in its camera; 0 for a subject outside the frame."""
    if not len(cameras):
        return np.zeros(0)
    seen = measure_visibility(
        subjects.posed_vehicles(), cameras, world=site.world.with_vehicles(others.posed_vehicles()), rays=rays
    )
    # nan is a vehicle that no ray met, since it is thinner than the distance of the rays.
    return np.nan_to_num(seen.fraction)


def visible_vehicle_mask(
    site: Site, subjects: Instances, others: Instances, cameras: Cameras, *, xywh: Float[np.ndarray, "n 4"]
) -> Bool[np.ndarray, " n"]:
    """Return which cameras' subjects, with these boxes, cover the center of a pixel, so that masks aren't empty."""
    framed = np.flatnonzero(~np.isnan(xywh[:, 0]))
    shown, world = (np.zeros(len(cameras), dtype=bool), site.world.with_vehicles(others.take_rows(framed).posed_vehicles()))
    subject, box = subjects.take(framed).in_own_rows().posed_vehicles(), round_field("bbox", xywh[framed])
    shown[framed] = visible_subject_mask(subject, cameras.take(framed), xywh=box, world=world)
    return shown


def limit_rejections(
    values: Float[np.ndarray, " n"], low: float, high: float = math.inf, *, below: Rejection, above: Rejection = Rejection.NONE
) -> UInt8[np.ndarray, " n"]:
    """Return the rejection of each value outside these inclusive limits; nan is below."""
    return np.where(values >= low, np.where(values <= high, Rejection.NONE, above), below).astype(np.uint8)
