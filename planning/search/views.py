"""Tries of cameras that show their targets within the config's limits, one per row (paper, section 2.1.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.annotate.boxes import Boxes
from hulldown.annotate.silhouettes import show_pixels
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose
from hulldown.camera.weather.extinction import air_contrast
from hulldown.geometry.columns import put
from hulldown.placement.rejection import Rejection
from hulldown.planning.config.schema import Config
from hulldown.planning.plan.row import rounded
from hulldown.planning.search.aiming import Aims, Tries, aims_of, framed
from hulldown.planning.search.block import Block
from hulldown.planning.search.instance_table import Instances
from hulldown.planning.search.sizing import boxes_of, fraction_of, no_boxes
from hulldown.planning.search.stage import Site
from hulldown.scene.visibility import visible_fraction

SIZED = 1e-9  # relative tolerance of solved sizes: the solver and the box's projection round differently
PLENTY = 1000.0  # visible square pixels of a box above which some pixel center surely shows the target


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


def try_cameras(block: Block, tries: Tries) -> Views:
    """Make cameras, and check them against the config's limits.

    Checks are in the order of their cost, and each applies to the rows that passed those before. Limits of distance and
    size don't apply to given cameras.
    """
    site, limits, aims = block.site, block.config.camera, aims_of(block, tries)
    views = no_views(len(tries.image))
    views.fov_x_deg[:] = rounded("fov_x_deg", aims.intrinsics.fov_x_deg)
    if aims.wishes is not None:
        views.sampled[:] = np.where(tries.undirected, aims.wishes.sampled, -1)
        views.followed[:] = np.where(aims.follows, aims.wishes.box, -1)
    views.rejection[:] = _of_distance(tries, aims, block.config)

    rows = np.flatnonzero(views.rejection == Rejection.NONE)
    targets, intrinsics = tries.targets.take(rows), aims.intrinsics.rows(rows)
    around = camera_pose(targets.centers, aims.distance[rows], aims.azimuth[rows], elevation=aims.elevation[rows])
    poses = np.where(np.isnan(aims.sized[rows]), around, aims.sized[rows])
    views.rejection[rows] = site.camera_room.rejections(
        poses[:, :3, 3],
        ground_clearance=limits.ground_clearance,
        obstacle_clearance=limits.obstacle_clearance,
        vehicles=[*targets.posed(), *tries.others.beside(rows)[0].posed()],
    )

    kept = np.flatnonzero(views.rejection[rows] == Rejection.NONE)
    rows, poses, targets, intrinsics = rows[kept], poses[kept], targets.take(kept), intrinsics.rows(kept)
    level = np.flatnonzero(np.isnan(aims.sized[rows, 0, 0]))
    poses[level] = framed(block, tries, poses[level], rows=rows[level], intrinsics=aims.intrinsics, roll=aims.roll)
    poses = rounded("world_from_camera", poses)  # labels follow from rounded poses
    views.world_from_camera[rows] = poses
    views.air_contrast[rows] = air_contrasts(targets, poses, tries.visibility_m[rows])
    boxes = boxes_of(targets, poses, intrinsics)
    put(views.boxes, rows, boxes)
    views.rejection[rows] = _of_box(boxes, aims, block.config, rows=rows, free=tries.free[rows])

    rows = rows[views.rejection[rows] == Rejection.NONE]
    views.visible_fraction[rows] = visible_shares(
        site, tries.targets, tries.others, views, rows, intrinsics=aims.intrinsics, rays=limits.visibility_rays
    )
    views.rejection[rows] = outside(
        views.visible_fraction[rows], *limits.visible_fraction, below=Rejection.HIDDEN, above=Rejection.EXPOSED
    )
    rows = rows[views.rejection[rows] == Rejection.NONE]
    rows = rows[views.visible_fraction[rows] * views.boxes.xywh[rows, 2:].prod(axis=1) < PLENTY]
    shown = pixels_shown(site, tries.targets, tries.others, views, rows, intrinsics=aims.intrinsics)
    views.rejection[rows[~shown]] = Rejection.HIDDEN
    return views


def _of_distance(tries: Tries, aims: Aims, config: Config) -> UInt8[np.ndarray, " n"]:
    """Rejections by distance, and by contrast at that distance."""
    distance = aims.distance
    contrast = air_contrast(tries.visibility_m, distance)
    faint = outside(contrast, config.weather.min_contrast, below=Rejection.FAINT)
    apart = outside(distance, *config.camera.distance_m, below=Rejection.DISTANCE, above=Rejection.DISTANCE)
    rejection = np.where(tries.free & (apart != Rejection.NONE), apart, faint)
    rejection[np.isnan(distance)] = Rejection.SIZE
    return rejection


def _of_box(
    boxes: Boxes, aims: Aims, config: Config, *, rows: Int[np.ndarray, " k"], free: Bool[np.ndarray, " k"]
) -> UInt8[np.ndarray, " k"]:
    """Rejections of these rows of `aims` by their targets' boxes."""
    limits, measure, follows = config.camera, config.camera.size_measure, aims.follows[rows]
    # A target outside the frame has the box nan, which is too small.
    small = outside(boxes.xywh[:, 2:].min(axis=1), limits.min_box_px, below=Rejection.SMALL)
    cut = outside(
        boxes.truncated_fraction, *limits.truncated_fraction, below=Rejection.TRUNCATION, above=Rejection.TRUNCATION
    )
    rejection = np.where(cut, cut, small)
    # Sizes can miss if part of the target is nearer than the near plane.
    if measure != "paper":
        filled, wanted = fraction_of(boxes.amodal, measure, config.render), aims.fraction[rows]
        rejection[free & ~follows & ~(np.abs(filled - wanted) <= SIZED * wanted)] = Rejection.SIZE
    if aims.wishes is not None:
        size, wanted = np.where(aims.wishes.wide[rows], *boxes.amodal[:, 2:].T), aims.wishes.pixels[rows]
        rejection[follows & ~(np.abs(size - wanted) <= SIZED * wanted)] = Rejection.SIZE
    return rejection


def views_of_others(
    site: Site,
    subjects: Instances,
    others: Instances,
    *,
    cameras: Views,
    intrinsics: Intrinsics,
    visibility_m: Float[np.ndarray, " n"],
    config: Config,
) -> tuple[Views, Bool[np.ndarray, " n"]]:
    """Return views of vehicles that aren't targets, and whether those with a class cover the center of any pixel.

    Row i of `subjects` and of `others` is camera i; `visibility_m` is nan in clear air.
    """
    every, rays = np.arange(len(subjects)), config.camera.visibility_rays
    seen = replace(
        cameras,
        boxes=boxes_of(subjects, cameras.world_from_camera, intrinsics),
        visible_fraction=visible_shares(site, subjects, others, cameras, every, intrinsics=intrinsics, rays=rays),
        air_contrast=air_contrasts(subjects, cameras.world_from_camera, visibility_m),
    )
    named, pixels = np.flatnonzero(subjects.fleet.classed[subjects.model]), np.zeros(len(subjects), dtype=bool)
    pixels[named] = pixels_shown(site, subjects, others, seen, named, intrinsics=intrinsics)
    return seen, pixels


def air_contrasts(
    instances: Instances, world_from_camera: Float[np.ndarray, "n 4 4"], visibility_m: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return the share of each vehicle's contrast after haze, between the camera and the center of its box."""
    away = instances.centers - world_from_camera[:, :3, 3]
    return air_contrast(visibility_m, np.sqrt((away * away).sum(axis=1)))


def visible_shares(
    site: Site,
    subjects: Instances,
    others: Instances,
    views: Views,
    rows: Int[np.ndarray, " k"],
    *,
    intrinsics: Intrinsics,
    rays: int,
) -> Float[np.ndarray, " k"]:
    """Visible share of the outline of the subject of each of these cameras; 0 for a subject outside the frame."""
    if not len(rows):
        return np.zeros(0)
    world, subject = site.world.with_vehicles(others.beside(rows)[0].posed()), subjects.take(rows).posed()
    seen = visible_fraction(
        subject, views.world_from_camera[rows], intrinsics=intrinsics.rows(rows), world=world, rays=rays
    )
    # nan is a vehicle that no ray met, since it is thinner than the distance of the rays.
    return np.nan_to_num(seen.fraction)


def pixels_shown(
    site: Site,
    subjects: Instances,
    others: Instances,
    views: Views,
    rows: Int[np.ndarray, " k"],
    *,
    intrinsics: Intrinsics,
) -> Bool[np.ndarray, " k"]:
    """Tell which of these cameras' subjects cover the center of any pixel, so that their masks aren't empty."""
    framed = ~np.isnan(views.boxes.xywh[rows, 0])
    rows, shown = rows[framed], np.zeros(len(rows), dtype=bool)
    world, subject = site.world.with_vehicles(others.beside(rows)[0].posed()), subjects.take(rows).posed()
    xywh = rounded("bbox", views.boxes.xywh[rows])
    shown[framed] = show_pixels(subject, views.world_from_camera[rows], intrinsics.rows(rows), xywh=xywh, world=world)
    return shown


def outside(
    values: Float[np.ndarray, " n"],
    low: float,
    high: float = math.inf,
    *,
    below: Rejection,
    above: Rejection = Rejection.NONE,
) -> UInt8[np.ndarray, " n"]:
    """Return the rejection of each value below or above these inclusive limits; nan is below."""
    return np.where(values >= low, np.where(values <= high, Rejection.NONE, above), below).astype(np.uint8)
