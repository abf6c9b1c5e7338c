"""One try per row at a camera that sees its target as the config wants it (paper, section 2.1.6)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int, UInt8

from camera.clearance import Spot
from camera.framing import frame_target
from camera.intrinsics import Intrinsics
from camera.shell import camera_pose, draw_azimuth, draw_elevation
from camera.visibility import visible_fraction
from planning.draws import Draws, Purpose, StackedGenerator, between
from planning.refusal import Refusal
from planning.schema import CameraSection, RenderSection
from planning.stage import Placed, Site


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

    def put(self, rows: Int[np.ndarray, " k"], other: Shots, taken: Int[np.ndarray, " k"]) -> None:
        """Overwrite some of the rows with some of another's."""
        for f in fields(self):
            getattr(self, f.name)[rows] = getattr(other, f.name)[taken]


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
    shots.fov_x_deg[:] = between(*limits.fov_x_deg, uniform[:, 0])
    baseline = baseline_distance(
        target.model.smallest, shots.fov_x_deg, between(*limits.target_fraction, uniform[:, 1]), render
    )
    distance = baseline * between(*limits.distance_factor, uniform[:, 2])
    azimuth = draw_azimuth(n, rng=rng)
    elevation_bounds = (math.radians(limits.elevation_deg[0]), math.radians(limits.elevation_deg[1]))
    elevation = draw_elevation(n, elevation_bounds, rng=rng, uniform_in=limits.elevation_sampling)
    shots.refusal[(distance < limits.distance_m[0]) | (distance > limits.distance_m[1])] = Refusal.DISTANCE

    rows = np.flatnonzero(shots.refusal == Refusal.NONE)
    poses = camera_pose(target.rows(rows).centres, distance[rows], azimuth[rows], elevation=elevation[rows])
    vehicles = [vehicle.rows(rows) for vehicle in (target, *others)]
    shots.refusal[rows] = spot_refusal(site, poses[:, :3, 3], vehicles, limits)

    on = shots.refusal[rows] == Refusal.NONE
    rows, poses = rows[on], poses[on]
    aimed_at = target.rows(rows)
    intrinsics = intrinsics_of(render, shots.fov_x_deg[rows])
    framed = frame_target(
        poses,
        aimed_at.corners(),
        intrinsics,
        rng=StackedGenerator(draws, Purpose.FRAMING, image[rows], attempt[rows]),
        spread=limits.framing,
        truncated=limits.truncated_fraction,
    )
    shots.world_from_camera[rows] = framed.world_from_camera
    boxes = target.model.boxes.boxes(
        aimed_at.world_from_vehicle, framed.world_from_camera, intrinsics, aimed_at.articulation
    )
    shots.bbox[rows], shots.bbox_amodal[rows] = boxes.xywh, boxes.amodal
    shots.truncated_fraction[rows] = boxes.truncated_fraction
    shots.refusal[rows] = box_refusal(boxes.xywh, boxes.truncated_fraction, limits)

    on = shots.refusal[rows] == Refusal.NONE
    rows = rows[on]
    seen = visible_fraction(
        target.model.target,
        target.world_from_vehicle[rows],
        shots.world_from_camera[rows],
        intrinsics=[i for i, keep in zip(intrinsics, on.tolist(), strict=True) if keep],
        articulation=target.rows(rows).articulation,
        ground=site.ground,
        obstacles=site.obstacles,
        others=[other.rows(rows).standing for other in others],
        rays=limits.visibility_rays,
    )
    # No ray met a target that is thinner than the rays are apart: nothing of it is known to be visible.
    shots.visible_fraction[rows] = np.nan_to_num(seen.fraction)
    low, high = limits.visible_fraction
    shots.refusal[rows[shots.visible_fraction[rows] < low]] = Refusal.HIDDEN
    shots.refusal[rows[shots.visible_fraction[rows] > high]] = Refusal.EXPOSED
    return shots


def intrinsics_of(render: RenderSection, fov_x_deg: Float[np.ndarray, " n"]) -> list[Intrinsics]:
    """The insides of cameras with these fields of view."""
    return [Intrinsics(render.width, render.height, math.radians(fov)) for fov in fov_x_deg.tolist()]


def baseline_distance(
    size: float, fov_x_deg: Float[np.ndarray, " n"], fraction: Float[np.ndarray, " n"], render: RenderSection
) -> Float[np.ndarray, " n"]:
    """D of equation 6, for every field of view and target fraction: `Intrinsics.distance_for` on stacks."""
    f_px = render.width / 2.0 / np.tan(np.radians(fov_x_deg) / 2.0)
    return size * f_px / (render.height * fraction)


def spot_refusal(
    site: Site, position: Float[np.ndarray, "n 3"], vehicles: list[Placed], limits: CameraSection
) -> UInt8[np.ndarray, " n"]:
    """Whether a camera may be at these places: above ground, clear of it, of obstacles and of vehicles."""
    spots = site.camera_room.judge(
        position,
        ground_clearance=limits.ground_clearance,
        obstacle_clearance=limits.obstacle_clearance,
        vehicles=[vehicle.standing for vehicle in vehicles],
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
