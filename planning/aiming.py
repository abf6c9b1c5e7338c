"""One try per row at a camera that sees its target as the config wants it (paper, section 2.1.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from camera.framing import frame_target
from camera.intrinsics import Lenses, Optics
from camera.shell import camera_pose, draw_azimuth, draw_elevation
from camera.visibility import visible_fraction
from camera.weather import air_contrast
from placement.rejection import Rejection
from planning.draws import Draws, Purpose, RowStreams, between
from planning.labels import pixels_shown
from planning.row import rounded
from planning.schema import CameraSection, Config, RenderSection
from planning.search_limits import AIR_CONTRAST, BOX_PX, DISTANCE, PIXELS, SIZED, TRUNCATED, VISIBLE
from planning.sizing import fraction_of, sized_cameras
from planning.stage import Placed, Site

PLENTY = 1000.0  # square pixels of a box times visible fraction from which on some pixel is sure to show the target


@dataclass(frozen=True, eq=False, slots=True)
class Views:
    """Cameras that were aimed, n of them, and what they see of one vehicle; nan where rejected before it was known.

    Parameters
    ----------
    world_from_camera
        (n, 4, 4) poses.
    fov_x
        (n,) horizontal field of view, radians.
    bbox, bbox_amodal
        (n, 4) boxes; nan where nothing of the vehicle is in the frame, or in front of the camera.
    truncated_fraction, visible_fraction
        (n,) shares; of what is out of the frame 1 and 0.
    air_contrast
        (n,) what the air leaves of the vehicle's contrast; see `camera.weather`.
    rejection
        (n,) codes of `Rejection`.
    """

    world_from_camera: Float[np.ndarray, "n 4 4"]
    fov_x: Float[np.ndarray, " n"]
    bbox: Float[np.ndarray, "n 4"]
    bbox_amodal: Float[np.ndarray, "n 4"]
    truncated_fraction: Float[np.ndarray, " n"]
    visible_fraction: Float[np.ndarray, " n"]
    air_contrast: Float[np.ndarray, " n"]
    rejection: UInt8[np.ndarray, " n"]


def no_views(n: int) -> Views:
    """Room for n views."""
    nan = np.nan
    return Views(
        np.full((n, 4, 4), nan),
        np.full(n, nan),
        np.full((n, 4), nan),
        np.full((n, 4), nan),
        np.full(n, nan),
        np.full(n, nan),
        np.full(n, nan),
        np.zeros(n, dtype=np.uint8),
    )


def try_cameras(
    site: Site,
    target: Placed,
    config: Config,
    *,
    draws: Draws,
    image: Int[np.ndarray, " n"],
    attempt: Int[np.ndarray, " n"],
    others: list[Placed],
    visibility_m: Float[np.ndarray, " n"],
) -> Views:
    """Try `attempt` of each image's camera; `visibility_m` is nan where the air is clear.

    Checks go from cheap to dear, and each is asked only of what passed those before.
    """
    n, limits, render = len(image), config.camera, config.render
    views = no_views(n)
    rng = RowStreams(draws, Purpose.CAMERA, image, attempt)
    uniform = rng.random((n, 3))
    views.fov_x[:] = np.radians(rounded("fov_x_deg", between(*limits.fov_x_deg, uniform[:, 0])))
    fraction = between(*limits.target_fraction, uniform[:, 1])
    azimuth = draw_azimuth(n, rng=rng)
    elevation_bounds = (math.radians(limits.elevation_deg[0]), math.radians(limits.elevation_deg[1]))
    elevation = draw_elevation(n, elevation_bounds, rng=rng, uniform_in=limits.elevation_sampling)

    def framing(rows: Int[np.ndarray, " k"]) -> RowStreams:
        return RowStreams(draws, Purpose.FRAMING, image[rows], attempt[rows])

    lens = lenses_of(render, views.fov_x)
    if limits.size_measure == "paper":
        distance = lens.distance_for(target.model.smallest, fraction)
        distance *= between(*limits.distance_factor, uniform[:, 2])
    else:
        every = np.arange(n)
        sized, distance = sized_cameras(
            target,
            limits,
            render,
            lens=lens,
            fraction=fraction,
            azimuth=azimuth,
            elevation=elevation,
            framing=lambda: framing(every),
        )
    faint = AIR_CONTRAST.rejections(air_contrast(visibility_m, distance), config)
    apart = DISTANCE.rejections(distance, config)
    views.rejection[:] = np.where(apart, apart, faint)
    views.rejection[np.isnan(distance)] = Rejection.SIZE

    rows = np.flatnonzero(views.rejection == Rejection.NONE)
    if limits.size_measure == "paper":
        poses = camera_pose(target.rows(rows).centres, distance[rows], azimuth[rows], elevation=elevation[rows])
    else:
        poses = sized[rows]
    vehicles = [vehicle.rows(rows) for vehicle in (target, *others)]
    views.rejection[rows] = camera_rejections(site, poses[:, :3, 3], vehicles, limits)

    on = views.rejection[rows] == Rejection.NONE
    rows, poses = rows[on], poses[on]
    aimed_at = target.rows(rows)
    lens = lens.rows(rows)
    if limits.size_measure == "paper":
        poses = frame_target(
            poses,
            aimed_at.corners(),
            lens,
            rng=framing(rows),
            spread=limits.framing,
            truncated=limits.truncated_fraction,
        ).world_from_camera
    poses = rounded("world_from_camera", poses)  # as they are written: labels follow from them
    views.world_from_camera[rows] = poses
    views.air_contrast[rows] = air_contrasts(aimed_at, poses, visibility_m[rows])
    boxes = target.model.boxes.boxes(aimed_at.world_from_vehicle, poses, lens, aimed_at.articulation)
    views.bbox[rows], views.bbox_amodal[rows] = boxes.xywh, boxes.amodal
    views.truncated_fraction[rows] = boxes.truncated_fraction
    # A target that is out of the frame has no box: nan is not large enough.
    small = BOX_PX.rejections(boxes.xywh[:, 2:].min(axis=1), config)
    cut = TRUNCATED.rejections(boxes.truncated_fraction, config)
    views.rejection[rows] = np.where(cut, cut, small)
    if limits.size_measure != "paper":
        # The box leaves out what is nearer than the near plane.
        filled = fraction_of(boxes.amodal, limits.size_measure, render)
        views.rejection[rows[~(np.abs(filled - fraction[rows]) <= SIZED * fraction[rows])]] = Rejection.SIZE

    framed = views.rejection[rows] == Rejection.NONE
    rows = rows[framed]
    views.visible_fraction[rows] = visible_shares(
        site,
        target.rows(rows),
        [other.rows(rows) for other in others],
        views.world_from_camera[rows],
        intrinsics=lens.rows(framed),
        rays=limits.visibility_rays,
    )
    views.rejection[rows] = VISIBLE.rejections(views.visible_fraction[rows], config)
    rows = rows[views.rejection[rows] == Rejection.NONE]
    rows = rows[views.visible_fraction[rows] * views.bbox[rows, 2:].prod(axis=1) < PLENTY]
    shown = pixels_shown(
        site,
        target.rows(rows),
        [other.rows(rows) for other in others],
        world_from_camera=views.world_from_camera[rows],
        fov_x=views.fov_x[rows],
        bbox=rounded("bbox", views.bbox[rows]),
        config=config,
    )
    views.rejection[rows[~shown]] = PIXELS.below
    return views


def views_of_companion(
    site: Site,
    vehicle: Placed,
    others: list[Placed],
    *,
    cameras: Views,
    visibility_m: Float[np.ndarray, " n"],
    config: Config,
) -> Views:
    """What each of these cameras sees of another vehicle than its target; `visibility_m` is nan in clear air."""
    lens = lenses_of(config.render, cameras.fov_x)
    boxes = vehicle.model.boxes.boxes(vehicle.world_from_vehicle, cameras.world_from_camera, lens, vehicle.articulation)
    visible = visible_shares(
        site,
        vehicle,
        others,
        cameras.world_from_camera,
        intrinsics=lens,
        rays=config.camera.visibility_rays,
    )
    return replace(
        cameras,
        bbox=boxes.xywh,
        bbox_amodal=boxes.amodal,
        truncated_fraction=boxes.truncated_fraction,
        visible_fraction=visible,
        air_contrast=air_contrasts(vehicle, cameras.world_from_camera, visibility_m),
    )


def air_contrasts(
    vehicle: Placed, world_from_camera: Float[np.ndarray, "n 4 4"], visibility_m: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """What the air leaves of each vehicle's contrast, from the camera to the centre of its box."""
    away = vehicle.centres - world_from_camera[:, :3, 3]
    return air_contrast(visibility_m, np.sqrt((away * away).sum(axis=1)))


def visible_shares(
    site: Site,
    vehicle: Placed,
    others: list[Placed],
    world_from_camera: Float[np.ndarray, "n 4 4"],
    *,
    intrinsics: Optics,
    rays: int,
) -> Float[np.ndarray, " n"]:
    """Visible share of each vehicle's outline; 0 where it is out of the frame."""
    seen = visible_fraction(
        vehicle.model.target,
        vehicle.world_from_vehicle,
        world_from_camera,
        intrinsics=intrinsics,
        articulation=vehicle.articulation,
        world=site.world.with_vehicles([other.posed for other in others]),
        rays=rays,
    )
    # No ray met a vehicle thinner than the rays are apart: nothing of it is known to be visible.
    return np.nan_to_num(seen.fraction)


def lenses_of(render: RenderSection, fov_x: Float[np.ndarray, " n"]) -> Lenses:
    """The insides of cameras with these fields of view, radians."""
    return Lenses.of(render.width, render.height, fov_x)


def camera_rejections(
    site: Site, position: Float[np.ndarray, "n 3"], vehicles: list[Placed], limits: CameraSection
) -> UInt8[np.ndarray, " n"]:
    """Whether a camera may be at these places: above ground, clear of it, of obstacles and of vehicles."""
    return site.camera_room.rejections(
        position,
        ground_clearance=limits.ground_clearance,
        obstacle_clearance=limits.obstacle_clearance,
        vehicles=[vehicle.posed for vehicle in vehicles],
        vehicle_clearance=limits.obstacle_clearance,
    )
