"""Tries of cameras that show their targets within the config's limits, one per row (paper, section 2.1.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.annotate.boxes import Boxes
from hulldown.annotate.silhouettes import show_pixels
from hulldown.annotate.visibility import visible_fraction
from hulldown.camera.cameras import Cameras
from hulldown.camera.weather.extinction import air_contrast
from hulldown.geometry.columns import put, take
from hulldown.placement.rejection import Rejection
from hulldown.plan.config.schema import Config
from hulldown.plan.row import rounded
from hulldown.planning.search.block import Block
from hulldown.planning.search.cameras import CameraCandidates, CameraRule, CameraTries, frame_targets, sample_cameras
from hulldown.planning.search.instance_table import Instances
from hulldown.planning.search.sizing import filled_fraction, no_boxes, vehicle_boxes
from hulldown.planning.search.stage import Site

SIZE_TOLERANCE = 1e-9  # relative, of solved sizes: the solver and the box's projection round differently
SURELY_VISIBLE_PX2 = 1000.0  # visible area of a box above which some pixel center surely shows the target


@dataclass(frozen=True, eq=False, slots=True)
class Views:
    """n cameras and what each sees of one vehicle; nan for values after a rejection."""

    # world_from_camera, fov_x_deg: poses, and (n,) horizontal fields of view
    world_from_camera: Float[np.ndarray, "n 4 4"]
    fov_x_deg: Float[np.ndarray, " n"]
    boxes: Boxes  # n boxes; nan for a vehicle outside the frame, or behind the camera
    visible_fraction: Float[np.ndarray, " n"]  # shares; 0 for a vehicle outside the frame
    air_contrast: Float[np.ndarray, " n"]  # share of the vehicle's contrast after haze; see `camera.weather.extinction`
    rejection: UInt8[np.ndarray, " n"]
    # sampled, followed: boxes of photographs; see `planning.search.likeness.Wishes`. -1: none.
    sampled: Int[np.ndarray, " n"]
    followed: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False, slots=True)
class Seen:
    """Views of p pairs of an image and an extra in it, ordered by image and then by instance."""

    image: Int[np.ndarray, " p"]  # image, instance: rows of the block's images and of its table
    instance: Int[np.ndarray, " p"]
    views: Views  # views of the p pairs
    pixels: Bool[np.ndarray, " p"]  # whether an extra that has a class covers the center of any pixel


def no_views(n: int) -> Views:
    """Allocate n views: nan, and no rejection."""
    return Views(
        np.full((n, 4, 4), np.nan),
        np.full(n, np.nan),
        no_boxes(n),
        np.full(n, np.nan),
        np.full(n, np.nan),
        np.zeros(n, dtype=np.uint8),
        np.full(n, -1),
        np.full(n, -1),
    )


def try_cameras(block: Block, tries: CameraTries) -> Views:
    """Make cameras, and check them against the config's limits.

    Checks are in the order of their cost, and each is of the rows that passed those before. Limits of distance and size
    don't apply to given cameras.
    """
    site, limits, config, candidates = block.site, block.config.camera, block.config, sample_cameras(block, tries)
    n = len(tries.image)
    views = no_views(n)
    views.fov_x_deg[:] = rounded("fov_x_deg", candidates.lenses.fov_x_deg)
    if (boxes := candidates.boxes) is not None:
        views.sampled[:] = np.where(tries.given.has_camera | tries.given.has_look_at, -1, boxes.sampled)
        views.followed[:] = np.where(candidates.rule == CameraRule.PHOTOGRAPH, boxes.box, -1)

    def passed() -> Int[np.ndarray, " k"]:
        return np.flatnonzero(views.rejection == Rejection.NONE)

    views.rejection[:] = reject_distance(candidates, tries.visibility_m, config)
    rows = passed()
    views.rejection[rows] = site.camera_room.rejections(
        candidates.world_from_camera[rows, :3, 3],
        ground_clearance=limits.ground_clearance,
        obstacle_clearance=limits.obstacle_clearance,
        vehicles=[*tries.targets.take(rows).posed(), *tries.others.beside(rows)[0].posed()],
    )

    rows = passed()
    cameras, unframed = candidates.cameras(rows), np.flatnonzero(~candidates.is_framed[rows])
    i = rows[unframed]
    framed = frame_targets(block, tries, cameras.take(unframed), rows=i, roll=candidates.roll[i])
    cameras.world_from_camera[unframed] = framed.world_from_camera
    # Labels follow from rounded poses.
    cameras = cameras.at_poses(rounded("world_from_camera", cameras.world_from_camera))
    targets = tries.targets.take(rows)
    views.world_from_camera[rows] = cameras.world_from_camera
    views.air_contrast[rows] = air_contrasts(targets, cameras, tries.visibility_m[rows])
    put(views.boxes, rows, vehicle_boxes(targets, cameras))
    views.rejection[rows] = reject_box(take(views.boxes, rows), candidates, rows, config)

    def visible() -> tuple[Instances, Instances, Cameras]:
        """Return targets, others, and cameras of these rows."""
        cameras = candidates.lenses.take(rows), views.world_from_camera[rows]
        return tries.targets.take(rows), tries.others.beside(rows)[0], Cameras(*cameras)

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
    beside = others.beside(named)[0]
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
    seen = visible_fraction(subjects.posed(), cameras, world=site.world.with_vehicles(others.posed()), rays=rays)
    # nan is a vehicle that no ray met, since it is thinner than the distance of the rays.
    return np.nan_to_num(seen.fraction)


def pixels_shown(
    site: Site, subjects: Instances, others: Instances, cameras: Cameras, *, xywh: Float[np.ndarray, "n 4"]
) -> Bool[np.ndarray, " n"]:
    """Tell which of the cameras' subjects, with these boxes, cover any pixel's center: their masks aren't empty."""
    framed = np.flatnonzero(~np.isnan(xywh[:, 0]))
    shown, world = np.zeros(len(cameras), dtype=bool), site.world.with_vehicles(others.beside(framed)[0].posed())
    subject, box = subjects.take(framed).posed(), rounded("bbox", xywh[framed])
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
