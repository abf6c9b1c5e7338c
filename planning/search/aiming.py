"""Tries of cameras that show their targets within the config's limits, one per row (paper, section 2.1.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.annotate.masks import show_pixels
from hulldown.camera.framing import Framed, frame_target, turned
from hulldown.camera.lenses import Lenses, lenses
from hulldown.camera.shell import camera_pose, draw_azimuth, draw_elevation, shell_axes, shell_place
from hulldown.camera.visibility import visibility_of
from hulldown.camera.weather import air_contrast
from hulldown.geometry.transforms import rigid
from hulldown.placement.rejection import Rejection
from hulldown.planning.config.schema import Config
from hulldown.planning.row import rounded
from hulldown.planning.search.columns import put, take
from hulldown.planning.search.draws import Purpose, RandomStreams, RowStreams, between
from hulldown.planning.search.given import Given
from hulldown.planning.search.instances import Instances, hull_of
from hulldown.planning.search.likeness import Likeness, directions_of, matching_cameras
from hulldown.planning.search.sizing import boxes_of, fraction_of, image_size, sized_cameras
from hulldown.planning.search.stage import Site

SIZED = 1e-9  # relative tolerance of solved sizes: the solver and the box's projection round differently
NEAREST = 1e-6  # least meters from a target's center to a given camera, which keeps the direction defined
PLENTY = 1000.0  # visible square pixels of a box above which some pixel center surely shows the target


@dataclass(frozen=True, eq=False, slots=True)
class Views:
    """n cameras and what each sees of one vehicle; nan for values after a rejection.

    Parameters
    ----------
    world_from_camera, lens
        (n, 4, 4) poses, and n intrinsics.
    bbox, bbox_amodal
        (n, 4) boxes; nan for a vehicle outside the frame, or behind the camera.
    truncated_fraction, visible_fraction
        (n,) shares; 1 and 0 for a vehicle outside the frame.
    air_contrast
        (n,) share of the vehicle's contrast after haze; see `camera.weather`.
    rejection
        (n,) codes of `Rejection`.
    asked, followed
        (n,) boxes of photographs; see `planning.search.likeness.Wishes`. -1: none.
    """

    world_from_camera: Float[np.ndarray, "n 4 4"]
    lens: Lenses
    bbox: Float[np.ndarray, "n 4"]
    bbox_amodal: Float[np.ndarray, "n 4"]
    truncated_fraction: Float[np.ndarray, " n"]
    visible_fraction: Float[np.ndarray, " n"]
    air_contrast: Float[np.ndarray, " n"]
    rejection: UInt8[np.ndarray, " n"]
    asked: Int[np.ndarray, " n"]
    followed: Int[np.ndarray, " n"]


def no_views(n: int) -> Views:
    """Allocate n views: nan, and no rejection."""
    nan = np.nan
    return Views(
        np.full((n, 4, 4), nan),
        Lenses.unknown(n),
        np.full((n, 4), nan),
        np.full((n, 4), nan),
        np.full(n, nan),
        np.full(n, nan),
        np.full(n, nan),
        np.zeros(n, dtype=np.uint8),
        np.full(n, -1),
        np.full(n, -1),
    )


def try_cameras(
    site: Site,
    targets: Instances,
    config: Config,
    *,
    draws: RandomStreams,
    image: Int[np.ndarray, " n"],
    given: Given,
    attempt: Int[np.ndarray, " n"],
    others: Instances,
    visibility_m: Float[np.ndarray, " n"],
    likeness: Likeness | None,
    quarter: Int[np.ndarray, " n"],
) -> Views:
    """Make try number `attempt` of each image's camera; `visibility_m` is nan where the air is clear.

    Row i of `targets` and of `others` is image i. Checks are in the order of their cost, and each applies to the rows
    that passed those before. Limits of distance and size don't apply to given cameras. `quarter` tells how many of an
    image's tries are used up; see `Likeness.wishes`.
    """
    n, limits, render = len(image), config.camera, config.render
    views = no_views(n)
    rng = RowStreams(draws, Purpose.CAMERA, image, attempt)
    uniform = rng.random((n, 3))
    together, free = given.sequence >= 0, np.isnan(given.camera[:, 0])
    of_sequence = draws.uniform(Purpose.SEQUENCE, np.maximum(given.sequence, 0), 0, count=2)
    uniform[:, 0] = np.where(together, of_sequence[:, 0], uniform[:, 0])
    lens = drawn_lenses(config, uniform[:, 0])
    put(views.lens, np.arange(n), lens)
    fraction = between(*limits.target_fraction, uniform[:, 1])
    azimuth = draw_azimuth(n, rng=rng)
    elevation_bounds = (math.radians(limits.elevation_deg[0]), math.radians(limits.elevation_deg[1]))
    elevation = draw_elevation(n, elevation_bounds, rng=rng, uniform_in=limits.elevation_sampling)
    roll = np.where(together, of_sequence[:, 1], rng.random((n, 1))[:, 0])
    roll = np.radians(between(*limits.roll_deg, roll))

    def framed(poses: Float[np.ndarray, "k 4 4"], rows: Int[np.ndarray, " k"]) -> Framed:
        aimed = frame_target(
            poses,
            targets.take(rows).corners(),
            lens.rows(rows),
            roll=roll[rows],
            rng=RowStreams(draws, Purpose.FRAMING, image[rows], attempt[rows]),
            spread=limits.framing,
            truncated=limits.truncated_fraction,
        )
        points = given.look_at[rows]
        at = np.flatnonzero(~np.isnan(points[:, 0]))
        position, own_lens = poses[at, :3, 3], lens.rows(rows[at])
        axes = shell_axes(*shell_place(position - points[at])[1:])[1]
        aimed.world_from_camera[at] = turned(rigid(axes, position), own_lens, own_lens.center, roll[rows[at]])
        return aimed

    wishes = None
    if likeness is not None:
        wishes = likeness.wishes(draws, targets, image=image, attempt=attempt, quarter=quarter)
        aimed_by_user = ~free | ~np.isnan(given.look_at[:, 0])
        views.asked[:] = np.where(aimed_by_user, -1, wishes.asked)
        views.followed[:] = np.where(aimed_by_user, -1, wishes.box)
    measure = limits.size_measure
    # Cameras that follow a photograph, and cameras whose target's box gets an exact size.
    alike = views.followed >= 0
    exact = alike if measure == "paper" else free
    sized, distance = np.full((n, 4, 4), np.nan), np.full(n, np.nan)
    if measure == "paper":
        smallest = targets.fleet.size.min(axis=1)[targets.model]
        distance = lens.distance_for(smallest, fraction)
        distance *= between(*limits.distance_factor, uniform[:, 2])
    else:
        for model, i in targets.by_model():
            i = i[free[i] & ~alike[i]]
            hull = hull_of(model, targets.world_from_vehicle[i], targets.model_angles(model, i))
            sized[i], distance[i] = sized_cameras(
                targets.take(i),
                hull,
                lens=lens.rows(i),
                pixels=fraction[i] * image_size(measure, render),
                measure=measure,
                azimuth=azimuth[i],
                elevation=elevation[i],
                roll=roll[i],
                framed=partial(framed, rows=i),
            )
    if wishes is not None:
        rows = np.flatnonzero(alike)
        sized[rows], distance[rows] = matching_cameras(
            targets.take(rows),
            take(wishes, rows),
            config,
            lens=lens.rows(rows),
            roll=roll[rows],
            rng=directions_of(draws, image[rows], attempt[rows]),
        )
    place = shell_place(given.camera - targets.centers)
    distance = np.where(free, distance, np.maximum(place[0], NEAREST))
    azimuth, elevation = (np.where(free, *pair) for pair in zip((azimuth, elevation), place[1:], strict=True))
    faint = outside(air_contrast(visibility_m, distance), config.weather.min_contrast, below=Rejection.FAINT)
    apart = outside(distance, *limits.distance_m, below=Rejection.DISTANCE, above=Rejection.DISTANCE)
    views.rejection[:] = np.where(free & (apart != Rejection.NONE), apart, faint)
    views.rejection[np.isnan(distance)] = Rejection.SIZE

    rows = np.flatnonzero(views.rejection == Rejection.NONE)
    around = camera_pose(targets.take(rows).centers, distance[rows], azimuth[rows], elevation=elevation[rows])
    poses = np.where(exact[rows, None, None], sized[rows], around)
    views.rejection[rows] = site.camera_room.rejections(
        poses[:, :3, 3],
        ground_clearance=limits.ground_clearance,
        obstacle_clearance=limits.obstacle_clearance,
        vehicles=[*targets.take(rows).posed(), *others.beside(rows)[0].posed()],
        vehicle_clearance=limits.obstacle_clearance,
    )

    on = views.rejection[rows] == Rejection.NONE
    rows, poses = rows[on], poses[on]
    aimed_at = targets.take(rows)
    level = np.flatnonzero(~exact[rows])
    poses[level] = framed(poses[level], rows[level]).world_from_camera
    poses = rounded("world_from_camera", poses)  # labels follow from rounded poses
    views.world_from_camera[rows] = poses
    views.air_contrast[rows] = air_contrasts(aimed_at, poses, visibility_m[rows])
    boxes = boxes_of(aimed_at, poses, lens.rows(rows))
    views.bbox[rows], views.bbox_amodal[rows] = boxes.xywh, boxes.amodal
    views.truncated_fraction[rows] = boxes.truncated_fraction
    # A target outside the frame has the box nan, which is too small.
    small = outside(boxes.xywh[:, 2:].min(axis=1), limits.min_box_px, below=Rejection.SMALL)
    cut = outside(
        boxes.truncated_fraction, *limits.truncated_fraction, below=Rejection.TRUNCATION, above=Rejection.TRUNCATION
    )
    views.rejection[rows] = np.where(cut, cut, small)
    # Sizes can miss if part of the target is nearer than the near plane.
    if measure != "paper":
        filled, wanted = fraction_of(boxes.amodal, measure, render), fraction[rows]
        views.rejection[rows[free[rows] & ~alike[rows] & ~(np.abs(filled - wanted) <= SIZED * wanted)]] = Rejection.SIZE
    if wishes is not None:
        size, wanted = np.where(wishes.wide[rows], *boxes.amodal[:, 2:].T), wishes.pixels[rows]
        views.rejection[rows[alike[rows] & ~(np.abs(size - wanted) <= SIZED * wanted)]] = Rejection.SIZE

    on = views.rejection[rows] == Rejection.NONE
    rows = rows[on]
    views.visible_fraction[rows] = visible_shares(
        site,
        targets.take(rows),
        others.beside(rows)[0],
        views.world_from_camera[rows],
        intrinsics=lens.rows(rows),
        rays=limits.visibility_rays,
    )
    views.rejection[rows] = outside(
        views.visible_fraction[rows], *limits.visible_fraction, below=Rejection.HIDDEN, above=Rejection.EXPOSED
    )
    rows = rows[views.rejection[rows] == Rejection.NONE]
    rows = rows[views.visible_fraction[rows] * views.bbox[rows, 2:].prod(axis=1) < PLENTY]
    shown = pixels_shown(
        site,
        targets.take(rows),
        others.beside(rows)[0],
        world_from_camera=views.world_from_camera[rows],
        lens=views.lens.rows(rows),
        bbox=rounded("bbox", views.bbox[rows]),
    )
    views.rejection[rows[~shown]] = Rejection.HIDDEN
    return views


def drawn_lenses(config: Config, uniform: Float[np.ndarray, " n"]) -> Lenses:
    """Return n lenses: the calibrated one, or fields of view in proportion to numbers in [0, 1)."""
    if config.calibrated is not None:
        return lenses(config.calibrated).spread(len(uniform))
    fov_x = np.radians(rounded("fov_x_deg", between(*config.camera.fov_x_deg, uniform)))
    return Lenses.of(config.render.width, config.render.height, fov_x)


def views_of_others(
    site: Site,
    subjects: Instances,
    others: Instances,
    *,
    cameras: Views,
    visibility_m: Float[np.ndarray, " n"],
    config: Config,
) -> tuple[Views, Bool[np.ndarray, " n"]]:
    """Return views of vehicles that aren't targets, and whether those with a class cover the center of any pixel.

    Row i of `subjects` and of `others` is camera i; `visibility_m` is nan in clear air.
    """
    lens = cameras.lens
    boxes = boxes_of(subjects, cameras.world_from_camera, lens)
    visible = visible_shares(
        site, subjects, others, cameras.world_from_camera, intrinsics=lens, rays=config.camera.visibility_rays
    )
    classed = np.array([model.category is not None for model in subjects.fleet.models])
    named, pixels = np.flatnonzero(classed[subjects.model]), np.zeros(len(subjects), dtype=bool)
    pixels[named] = pixels_shown(
        site,
        subjects.take(named),
        others.beside(named)[0],
        world_from_camera=cameras.world_from_camera[named],
        lens=lens.rows(named),
        bbox=rounded("bbox", boxes.xywh[named]),
    )
    seen = replace(
        cameras,
        bbox=boxes.xywh,
        bbox_amodal=boxes.amodal,
        truncated_fraction=boxes.truncated_fraction,
        visible_fraction=visible,
        air_contrast=air_contrasts(subjects, cameras.world_from_camera, visibility_m),
    )
    return seen, pixels


def air_contrasts(
    instances: Instances, world_from_camera: Float[np.ndarray, "n 4 4"], visibility_m: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Share of each vehicle's contrast after haze, between the camera and the center of its box."""
    away = instances.centers - world_from_camera[:, :3, 3]
    return air_contrast(visibility_m, np.sqrt((away * away).sum(axis=1)))


def visible_shares(
    site: Site,
    subjects: Instances,
    others: Instances,
    world_from_camera: Float[np.ndarray, "n 4 4"],
    *,
    intrinsics: Lenses,
    rays: int,
) -> Float[np.ndarray, " n"]:
    """Visible share of the outline of each camera's subject; 0 for a subject outside the frame."""
    if not len(subjects):
        return np.zeros(0)
    world = site.world.with_vehicles(others.posed())
    seen = visibility_of(subjects.posed(), world_from_camera, intrinsics=intrinsics, world=world, rays=rays)
    # nan is a vehicle that no ray met, since it is thinner than the distance of the rays.
    return np.nan_to_num(seen.fraction)


def pixels_shown(
    site: Site,
    subjects: Instances,
    others: Instances,
    *,
    world_from_camera: Float[np.ndarray, "n 4 4"],
    lens: Lenses,
    bbox: Float[np.ndarray, "n 4"],
) -> Bool[np.ndarray, " n"]:
    """Whether the subject of each camera covers the center of any pixel, so that its mask isn't empty."""
    shown = np.zeros(len(bbox), dtype=bool)
    rows = np.flatnonzero(~np.isnan(bbox[:, 0]))
    world = site.world.with_vehicles(others.beside(rows)[0].posed())
    subject = subjects.take(rows).posed()
    shown[rows] = show_pixels(subject, world_from_camera[rows], lens.rows(rows), xywh=bbox[rows], world=world)
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
