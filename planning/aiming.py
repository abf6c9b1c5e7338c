"""One try per row at a camera that sees its target as the config wants it (paper, section 2.1.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int, UInt8

from camera.clearance import Spot
from camera.framing import frame_target
from camera.intrinsics import Intrinsics, Lenses, Optics, lenses
from camera.shell import camera_pose, draw_azimuth, draw_elevation
from camera.visibility import visible_fraction
from planning.draws import Draws, Purpose, StackedGenerator, between
from planning.refusal import Refusal
from planning.row import rounded
from planning.schema import CameraSection, RenderSection
from planning.sizing import fraction_of, sized_cameras
from planning.stage import Placed, Site

SIZED = 1e-9  # of the wanted size: the solve and the box's own projection round differently


@dataclass(frozen=True, eq=False, slots=True)
class Shots:
    """Cameras that were aimed, n of them, and what they see of the target; nan where refused before it was known.

    Parameters
    ----------
    world_from_camera
        (n, 4, 4) poses.
    fov_x_deg
        (n,) horizontal field of view.
    bbox, bbox_amodal
        (n, 4) boxes.
    truncated_fraction, visible_fraction
        (n,) shares.
    refusal
        (n,) codes of `Refusal`.
    """

    world_from_camera: Float[np.ndarray, "n 4 4"]
    fov_x_deg: Float[np.ndarray, " n"]
    bbox: Float[np.ndarray, "n 4"]
    bbox_amodal: Float[np.ndarray, "n 4"]
    truncated_fraction: Float[np.ndarray, " n"]
    visible_fraction: Float[np.ndarray, " n"]
    refusal: UInt8[np.ndarray, " n"]

    def of(self, rows: Int[np.ndarray, " k"]) -> Shots:
        """Some of the rows."""
        return Shots(*(getattr(self, f.name)[rows] for f in fields(self)))

    def put(self, rows: Int[np.ndarray, " k"], other: Shots, taken: Int[np.ndarray, " k"]) -> None:
        """Overwrite some of the rows with some of another's."""
        for f in fields(self):
            getattr(self, f.name)[rows] = getattr(other, f.name)[taken]


@dataclass(frozen=True, slots=True)
class Glimpse:
    """What one camera sees of one companion.

    Parameters
    ----------
    bbox, bbox_amodal
        Boxes; None where nothing of it is in the frame, or in front of the camera.
    visible_fraction, truncated_fraction
        Shares; of what is out of the frame 0 and 1.
    """

    bbox: list[float] | None
    bbox_amodal: list[float] | None
    visible_fraction: float
    truncated_fraction: float


def no_shots(n: int) -> Shots:
    """Room for n shots."""
    nan = np.nan
    return Shots(
        np.full((n, 4, 4), nan),
        np.full(n, nan),
        np.full((n, 4), nan),
        np.full((n, 4), nan),
        np.full(n, nan),
        np.full(n, nan),
        np.zeros(n, dtype=np.uint8),
    )


def try_cameras(
    site: Site,
    target: Placed,
    limits: CameraSection,
    render: RenderSection,
    *,
    draws: Draws,
    image: Int[np.ndarray, " n"],
    attempt: Int[np.ndarray, " n"],
    others: list[Placed],
) -> Shots:
    """Try `attempt` of each image's camera.

    Checks go from cheap to dear, and each is asked only of what passed those before.
    """
    n = len(image)
    shots = no_shots(n)
    rng = StackedGenerator(draws, Purpose.CAMERA, image, attempt)
    uniform = rng.random((n, 3))
    shots.fov_x_deg[:] = rounded("fov_x_deg", between(*limits.fov_x_deg, uniform[:, 0]))
    fraction = between(*limits.target_fraction, uniform[:, 1])
    azimuth = draw_azimuth(n, rng=rng)
    elevation_bounds = (math.radians(limits.elevation_deg[0]), math.radians(limits.elevation_deg[1]))
    elevation = draw_elevation(n, elevation_bounds, rng=rng, uniform_in=limits.elevation_sampling)

    def framing(rows: Int[np.ndarray, " k"]) -> StackedGenerator:
        return StackedGenerator(draws, Purpose.FRAMING, image[rows], attempt[rows])

    if limits.size_measure == "paper":
        distance = Lenses.of(render.width, render.height, np.radians(shots.fov_x_deg)).distance_for(
            target.model.smallest, fraction
        )
        distance *= between(*limits.distance_factor, uniform[:, 2])
    else:
        every = np.arange(n)
        sized, distance = sized_cameras(
            target,
            limits,
            render,
            intrinsics=intrinsics_of(render, shots.fov_x_deg),
            fraction=fraction,
            azimuth=azimuth,
            elevation=elevation,
            framing=lambda: framing(every),
        )
        shots.refusal[np.isnan(distance)] = Refusal.SIZE
    shots.refusal[(distance < limits.distance_m[0]) | (distance > limits.distance_m[1])] = Refusal.DISTANCE

    rows = np.flatnonzero(shots.refusal == Refusal.NONE)
    if limits.size_measure == "paper":
        poses = camera_pose(target.rows(rows).centres, distance[rows], azimuth[rows], elevation=elevation[rows])
    else:
        poses = sized[rows]
    vehicles = [vehicle.rows(rows) for vehicle in (target, *others)]
    shots.refusal[rows] = spot_refusal(site, poses[:, :3, 3], vehicles, limits)

    on = shots.refusal[rows] == Refusal.NONE
    rows, poses = rows[on], poses[on]
    aimed_at = target.rows(rows)
    intrinsics = intrinsics_of(render, shots.fov_x_deg[rows])
    lens = lenses(intrinsics)
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
    shots.world_from_camera[rows] = poses
    boxes = target.model.boxes.boxes(aimed_at.world_from_vehicle, poses, intrinsics, aimed_at.articulation)
    shots.bbox[rows], shots.bbox_amodal[rows] = boxes.xywh, boxes.amodal
    shots.truncated_fraction[rows] = boxes.truncated_fraction
    shots.refusal[rows] = box_refusal(boxes.xywh, boxes.truncated_fraction, limits)
    if limits.size_measure != "paper":
        # The box leaves out what is nearer than the near plane.
        filled = fraction_of(boxes.amodal, limits.size_measure, render)
        shots.refusal[rows[~(np.abs(filled - fraction[rows]) <= SIZED * fraction[rows])]] = Refusal.SIZE

    framed = shots.refusal[rows] == Refusal.NONE
    rows = rows[framed]
    shots.visible_fraction[rows] = visible_shares(
        site,
        target.rows(rows),
        [other.rows(rows) for other in others],
        shots.world_from_camera[rows],
        intrinsics=lens.rows(framed),
        rays=limits.visibility_rays,
    )
    low, high = limits.visible_fraction
    shots.refusal[rows[shots.visible_fraction[rows] < low]] = Refusal.HIDDEN
    shots.refusal[rows[shots.visible_fraction[rows] > high]] = Refusal.EXPOSED
    return shots


def glimpse(
    site: Site, vehicle: Placed, others: list[Placed], shots: Shots, limits: CameraSection, render: RenderSection
) -> list[Glimpse]:
    """What each shot's camera sees of another vehicle than its target."""
    intrinsics = intrinsics_of(render, shots.fov_x_deg)
    boxes = vehicle.model.boxes.boxes(
        vehicle.world_from_vehicle, shots.world_from_camera, intrinsics, vehicle.articulation
    )
    visible = visible_shares(
        site, vehicle, others, shots.world_from_camera, intrinsics=intrinsics, rays=limits.visibility_rays
    )
    return [
        Glimpse(
            bbox=None if bbox[0] != bbox[0] else bbox,
            bbox_amodal=None if amodal[0] != amodal[0] else amodal,
            visible_fraction=share,
            truncated_fraction=truncated,
        )
        for bbox, amodal, share, truncated in zip(
            boxes.xywh.tolist(),
            boxes.amodal.tolist(),
            visible.tolist(),
            boxes.truncated_fraction.tolist(),
            strict=True,
        )
    ]


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


def intrinsics_of(render: RenderSection, fov_x_deg: Float[np.ndarray, " n"]) -> list[Intrinsics]:
    """The insides of cameras with these fields of view."""
    return [Intrinsics(render.width, render.height, math.radians(fov)) for fov in fov_x_deg.tolist()]


def spot_refusal(
    site: Site, position: Float[np.ndarray, "n 3"], vehicles: list[Placed], limits: CameraSection
) -> UInt8[np.ndarray, " n"]:
    """Whether a camera may be at these places: above ground, clear of it, of obstacles and of vehicles."""
    spots = site.camera_room.judge(
        position,
        ground_clearance=limits.ground_clearance,
        obstacle_clearance=limits.obstacle_clearance,
        vehicles=[vehicle.posed for vehicle in vehicles],
        vehicle_clearance=limits.obstacle_clearance,
    )
    return _OF_SPOT[spots]


_OF_SPOT = np.zeros(len(Spot), dtype=np.uint8)
for _spot, _refusal in {
    Spot.OFF_GROUND: Refusal.CAMERA_OFF_GROUND,
    Spot.LOW: Refusal.CAMERA_LOW,
    Spot.OBSTACLE: Refusal.CAMERA_OBSTACLE,
    Spot.VEHICLE: Refusal.CAMERA_VEHICLE,
}.items():
    _OF_SPOT[_spot] = _refusal


def box_refusal(
    xywh: Float[np.ndarray, "n 4"], truncated: Float[np.ndarray, " n"], limits: CameraSection
) -> UInt8[np.ndarray, " n"]:
    """Whether these boxes are as the config wants them."""
    low, high = limits.truncated_fraction
    refusal = np.zeros(len(xywh), dtype=np.uint8)
    refusal[~((truncated >= low) & (truncated <= high))] = Refusal.TRUNCATION
    # A target that is out of the frame has no box: nan is not large enough.
    refusal[(refusal == 0) & ~(xywh[:, 2:].min(axis=1) >= limits.min_box_px)] = Refusal.SMALL
    return refusal
