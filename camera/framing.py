"""Turn cameras so that the target is off-center: completely in the frame, or truncated on purpose (paper 2.1.6)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.base.portable import exp, hypot, log
from hulldown.base.uniform import UniformNumbers
from hulldown.camera.cameras import Cameras
from hulldown.geometry.transforms import rotate_vectors, rotation_z, tilt_rotation

# Turning changes the box a little, so its place is found by iteration; a telephoto lens needs one or two rounds.
MAX_FRAMING_ROUNDS = 20
PLACE_TOLERANCE_PX = 1e-3
MAX_LEVEL_FRAMING_ROUNDS = 12  # Broyden's method takes 3 to 8
MIN_BOX_CHANGE_SHARE = 0.1  # of the expected change of the box's place; see `_FramingSearch.cameras_by_secants`


def pan_center_to_pixel(cameras: Cameras, pixel: ArrayLike, roll: ArrayLike = 0.0) -> Cameras:
    """Return the cameras turned on the spot so that what was on their optical axes falls on `pixel`, and rolled.

    A level horizon stays level but for the roll, as on a tripod, where the view is flat enough for that:
    cos(elevation) above sin(fov_x / 2). Steeper cameras, and those that aren't level, turn by the smallest rotation.

    `pixel`: pixels, in the frame or out of it; leading axes broadcast against those of the poses.
    `roll`: radians about the optical axis, from x to y: positive lowers the camera's right side.
    """
    uv = checked_array(pixel, "pixel", ("...", 2))
    through = cameras.lenses.pixel_directions(uv[..., None, :])[..., 0, :]
    return cameras.with_poses(_panned_poses(cameras, through, roll))


def _panned_poses(
    cameras: Cameras, through: Float[np.ndarray, "... 3"], roll: ArrayLike, *, keep_level: bool = True
) -> Float[np.ndarray, "... 4 4"]:
    pose = cameras.world_from_camera
    seen = through / np.linalg.norm(through, axis=-1, keepdims=True)
    about_axis = None
    if np.any(roll):
        about_axis = rotation_z(roll)
        seen = rotate_vectors(about_axis, seen[..., None, :])[..., 0, :]  # as the camera would see it without the roll
    lead = np.broadcast_shapes(pose.shape[:-2], seen.shape[:-1])
    out = np.array(np.broadcast_to(pose, (*lead, 4, 4)))
    rotation = np.array(out[..., :3, :3])
    seen = np.broadcast_to(seen, (*lead, 3))
    flat = hypot(rotation[..., 0, 2], rotation[..., 1, 2])
    steep = flat <= cameras.lenses.sin_half_fov_x
    level = np.asarray(keep_level & ~steep & (np.abs(rotation[..., 2, 0]) < 1e-9) & (flat > np.abs(seen[..., 0])))
    smallest = rotate_vectors(tilt_rotation(seen), rotation)
    out[..., :3, :3] = np.where(level[..., None, None], _panned_axes(rotation, seen, level), smallest)
    if about_axis is not None:
        out[..., :3, :3] = rotate_vectors(np.swapaxes(about_axis, -1, -2), out[..., :3, :3])
    return out


def _panned_axes(
    rotation: Float[np.ndarray, "... 3 3"], seen: Float[np.ndarray, "... 3"], possible: Bool[np.ndarray, "..."]
) -> Float[np.ndarray, "... 3 3"]:
    """Return the level camera's axes, in which the old forward direction has the camera coordinates `seen`."""
    right, forward = rotation[..., :, 0], rotation[..., :, 2]
    seen_x, seen_y, seen_z = np.moveaxis(seen, -1, 0)
    flat, rise = hypot(forward[..., 0], forward[..., 1]), forward[..., 2]
    # With the pitch p, seen's height above the horizon is seen_z sin p - seen_y cos p, which must be `rise`. The cosine
    # is taken from the horizontal parts, since sqrt(1 - sin^2) would lose half the digits in a steep view.
    cosine = np.sqrt(np.where(possible, (flat - np.abs(seen_x)) * (flat + np.abs(seen_x)), 1.0))
    # The pitch is the sum of two angles, that of (seen_z, seen_y) and that of (cosine, rise).
    along, up = seen_z * cosine - seen_y * rise, seen_y * cosine + seen_z * rise
    cp, sp = _unit_vector(along, up)
    # The old heading lies to the right of the new one by this angle.
    ca, sa = _unit_vector(seen_z * cp + seen_y * sp, seen_x)
    old_x, old_y = -right[..., 1], right[..., 0]
    x, y, zero = ca * old_x - sa * old_y, sa * old_x + ca * old_y, np.zeros_like(cp)
    axes = [np.stack([y, -x, zero], -1), np.stack([sp * x, sp * y, -cp], -1), np.stack([cp * x, cp * y, sp], -1)]
    return np.stack(axes, -1)


def _unit_vector(x: ArrayLike, y: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.asarray(x), np.asarray(y)  # one camera's are numbers
    length = hypot(x, y)
    length = np.where(length > 0.0, length, 1.0)
    return np.asarray(x / length), np.asarray(y / length)


def turn_cameras_to_targets(
    cameras: Cameras,
    points_world: ArrayLike,
    *,
    rng: UniformNumbers,
    roll: ArrayLike = 0.0,
    spread: float = 1.0,
    truncated: tuple[float, float] = (0.0, 0.0),
) -> Cameras:
    """Turn each camera so that the target's box has a random place in the frame, with the wanted part of it inside.

    The part to cut is drawn uniformly from `truncated`. With nothing to cut, the box's place is uniform over all that
    keep it in the frame. Otherwise it is uniform over all places at which the frame's edges cut off just that share of
    its area, through one side or over a corner.

    `roll`: or (n,) radians; see `pan_center_to_pixel`.
    `truncated`: least and largest share of the box's area to be cut off, within 0 to 1.
    """
    points = checked_array(points_world, "points_world", ("m", "k", 3))
    if len(points) not in (1, len(cameras)):
        raise ValueError(f"points_world: expected 1 or {len(cameras)} sets of points, got {len(points)}")
    if not 0.0 <= spread <= 1.0:
        raise ValueError(f"spread: expected 0 to 1, got {spread}")
    if not 0.0 <= truncated[0] <= truncated[1] <= 1.0:
        raise ValueError(f"truncated: expected 0 <= low <= high <= 1, got {truncated}")
    n, size = len(cameras), cameras.lenses.size
    rolls = np.broadcast_to(np.asarray(roll, dtype=np.float64), (n,))
    first = pan_center_to_pixel(cameras, cameras.lenses.center, rolls) if rolls.any() else cameras
    box = _projected_boxes(first, points)
    known = np.isfinite(box).all(axis=(1, 2))
    extent = np.where(known[:, None], np.maximum(box[:, 1] - box[:, 0], 1e-9), 1.0)
    way, side, place, cut = np.split(rng.random((n, 5)), (1, 2, 4), axis=1)
    inside_share = 1.0 - (truncated[0] + cut[:, 0] * (truncated[1] - truncated[0]))
    cuts = _sample_frame_cuts(extent, size, inside_share, way_choice=way[:, 0], side_choice=side[:, 0])
    place = 0.5 + spread * (place - 0.5)

    def corner(rows: Int[np.ndarray, " r"], extent: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r 2"]:
        inside = cuts.inside[rows]
        cut = np.where(cuts.at_high[rows], size - inside * extent, (inside - 1.0) * extent)
        return np.where(cuts.is_cut[rows], cut, place[rows] * (size - extent))

    search = _FramingSearch(cameras, points, rolls, corner)
    return search.cameras_by_secants(first, box) if truncated[1] > 0.0 else search.cameras_by_iteration(first, box)


def turn_cameras_to_boxes(
    cameras: Cameras,
    points_world: ArrayLike,
    *,
    corners: Float[np.ndarray, "n 4"],
    cut: Bool[np.ndarray, "n 4"],
    kept: ArrayLike = 0.0,
    roll: ArrayLike = 0.0,
) -> Cameras:
    """Turn each camera so that the target's box is where another box is, for boxes of any sizes.

    Along an axis on which neither side of the frame cuts the other box off, their centers agree as far as the target
    fits into the frame. Where one side does, it cuts the target off as well, and their sides within the frame agree, as
    far as that leaves enough of the target.

    `corners`: left, top, right, and bottom side of the other box in the frame, pixels.
    `cut`: whether the frame cuts it off there.
    `kept`: or (n, 2) least share of the target's width and height in the frame.
    """
    points = checked_array(points_world, "points_world", ("n", "k", 3))
    size, least = cameras.lenses.size, np.broadcast_to(kept, (len(cameras), 2))
    rolls = np.broadcast_to(np.asarray(roll, dtype=np.float64), (len(cameras),))
    first = pan_center_to_pixel(cameras, cameras.lenses.center, rolls) if rolls.any() else cameras
    (low, high), (cut_low, cut_high) = (np.split(each, 2, axis=1) for each in (corners, cut))

    def corner(rows: Int[np.ndarray, " r"], extent: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r 2"]:
        room, inside = size - extent, least[rows] * extent
        middle = (low[rows] + high[rows] - extent) / 2.0
        at_low = np.clip(high[rows], inside, extent) - extent
        places = [middle, at_low, np.maximum(np.minimum(low[rows], size - inside), room)]
        kinds = [cut_low[rows] & cut_high[rows], cut_low[rows], cut_high[rows]]
        return np.select(kinds, places, np.clip(middle, np.minimum(room, 0.0), np.maximum(room, 0.0)))

    search = _FramingSearch(cameras, points, rolls, corner)
    return search.cameras_by_iteration(first, _projected_boxes(first, points))


@dataclass(frozen=True, eq=False, slots=True)
class _FramingSearch:
    """Cameras to be turned until each box's upper left corner is where `corner` wants it for a box of that size."""

    cameras: Cameras
    points: Float[np.ndarray, "m k 3"]
    rolls: Float[np.ndarray, " n"]
    corner: Callable[[Int[np.ndarray, " r"], Float[np.ndarray, "r 2"]], Float[np.ndarray, "r 2"]]

    def poses_and_steps_at_pixels(
        self, rows: Int[np.ndarray, " r"], pixel: Float[np.ndarray, "r 2"], *, keep_level: bool = True
    ) -> tuple[Float[np.ndarray, "r 4 4"], Float[np.ndarray, "r 2"]]:
        """Return cameras turned to these pixels, and the pixels from each box to its place; nan if it isn't in view."""
        cameras = self.cameras.take(rows)
        through = cameras.lenses.pixel_directions(pixel[:, None])[:, 0]
        unseen = np.isnan(through[:, 0])  # beyond the fold of a distorted lens
        through[unseen] = 0.0, 0.0, 1.0
        cameras = cameras.with_poses(_panned_poses(cameras, through, self.rolls[rows], keep_level=keep_level))
        box = _projected_boxes(cameras, self.points if len(self.points) == 1 else self.points[rows])
        step = self.corner(rows, box[:, 1] - box[:, 0]) - box[:, 0]
        step[unseen] = math.nan
        return cameras.world_from_camera, step

    def cameras_by_iteration(self, first: Cameras, box: Float[np.ndarray, "n 2 2"]) -> Cameras:
        n = len(self.cameras)
        best, best_pixel = first.world_from_camera.copy(), np.tile(self.cameras.lenses.center, (n, 1))
        best_miss = np.full(n, np.inf)
        # Finished cameras stay as they are, so a result doesn't depend on the other cameras.
        todo = np.flatnonzero(np.isfinite(box).all(axis=(1, 2)))
        pixel = best_pixel[todo]
        for _ in range(MAX_FRAMING_ROUNDS):
            if not len(todo):
                break
            pose, step = self.poses_and_steps_at_pixels(todo, pixel)
            miss = np.abs(step).max(axis=1)
            better = miss < best_miss[todo]
            rows = todo[better]
            best[rows], best_pixel[rows], best_miss[rows] = pose[better], pixel[better], miss[better]
            # Halved steps from the best place so far where the last one led away (very wide lenses).
            pixel = np.where(better[:, None], pixel + step, (pixel + best_pixel[todo]) / 2.0)
            on = best_miss[todo] > PLACE_TOLERANCE_PX
            todo, pixel = todo[on], pixel[on]
        return self.cameras.with_poses(best)

    def cameras_by_secants(self, first: Cameras, box: Float[np.ndarray, "n 2 2"]) -> Cameras:
        """Turn cameras by Broyden's method, which gets there where the box changes as quickly as the camera turns.

        Out of the frame, the turn that keeps the horizon level may end before the box is there. By the smallest turn,
        a box that stays in front of the camera gets everywhere: its distance to the pixel is bounded.

        C. G. Broyden, A class of methods for solving nonlinear simultaneous equations, Mathematics of Computation
        19(92), 1965, method 1.
        """
        best, best_miss = first.world_from_camera.copy(), np.full(len(self.cameras), np.inf)
        todo = np.flatnonzero(np.isfinite(box).all(axis=(1, 2)))
        for keep_level, rounds in ((True, MAX_LEVEL_FRAMING_ROUNDS), (False, MAX_FRAMING_ROUNDS)):
            pixel = np.tile(self.cameras.lenses.center, (len(todo), 1))
            last, last_step = pixel, np.zeros_like(pixel)
            turn = np.tile(np.eye(2), (len(todo), 1, 1))  # change of the pixel per change of the box's place
            for _ in range(rounds):
                if not len(todo):
                    break
                pose, step = self.poses_and_steps_at_pixels(todo, pixel, keep_level=keep_level)
                miss = np.abs(step).max(axis=1)
                better = miss < best_miss[todo]
                best[todo[better]], best_miss[todo[better]] = pose[better], miss[better]
                moved, expected = pixel - last, _matrix_vector_products(turn, last_step - step)
                along = (moved * expected).sum(axis=1)
                # Updates that would make the next steps huge are left out.
                sound = along > MIN_BOX_CHANGE_SHARE * (moved * moved).sum(axis=1)
                change = (moved - expected)[:, :, None] * _matrix_vector_products(np.swapaxes(turn, 1, 2), moved)[:, None]
                turn[sound] += change[sound] / along[sound, None, None]
                # A target that left the view is looked for halfway back.
                seen = np.isfinite(step).all(axis=1)[:, None]
                onward = np.where(seen, pixel + _matrix_vector_products(turn, step), (pixel + last) / 2.0)
                last, last_step = np.where(seen, pixel, last), np.where(seen, step, last_step)
                on = best_miss[todo] > PLACE_TOLERANCE_PX
                todo, turn = todo[on], turn[on]
                pixel, last, last_step = onward[on], last[on], last_step[on]
        return self.cameras.with_poses(best)


def _matrix_vector_products(matrix: Float[np.ndarray, "r 2 2"], vector: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r 2"]:
    return (matrix * vector[:, None]).sum(axis=2)


def _projected_boxes(cameras: Cameras, points: Float[np.ndarray, "m k 3"]) -> Float[np.ndarray, "n 2 2"]:
    """Return low and high corner of the projected points; nan if one of them isn't in front."""
    pixels = cameras.project(points).pixels
    return np.stack([pixels.min(axis=1), pixels.max(axis=1)], 1)


@dataclass(frozen=True, eq=False, slots=True)
class _Cuts:
    """What the frame cuts off of n boxes, along x and y."""

    is_cut: Bool[np.ndarray, "n 2"]  # whether the frame cuts along this axis; if not, the place is free
    at_high: Bool[np.ndarray, "n 2"]  # whether it cuts at the right or bottom side, or else at the left or top
    inside: Float[np.ndarray, "n 2"]  # share of the box's width or height in the frame


def _sample_frame_cuts(
    extent: Float[np.ndarray, "n 2"],
    size: Float[np.ndarray, "2"],
    inside_share: Float[np.ndarray, " n"],
    *,
    way_choice: Float[np.ndarray, " n"],
    side_choice: Float[np.ndarray, " n"],
) -> _Cuts:
    """Draw how the frame cuts boxes so that this share of their areas is inside, by uniform numbers for way and side.

    The frame cuts a vertical side, a horizontal side, or two sides at a corner (ways 0, 1, 2). Let s be the share inside. All
    places of the box with that s are equally likely, so a way's weight is the area of its places with shares between s and
    s + ds, over ds. A cut vertical side moves by width ds / most_y, at 2 sides and along room_y: 2 room_y width / most_y; the
    like for horizontal ones. At each of 4 corners, width height times the integral of ds dx / x over the shares x of the width,
    from s / most_y to most_x: 4 width height ln(most_x most_y / s), with x log-uniform. A box that needn't be cut isn't.
    """
    (width, height), (room_x, room_y) = extent.T, np.abs(size - extent).T
    most_x, most_y = np.minimum(1.0, size / extent).T  # shares of the width and the height that fit into the frame
    most = most_x * most_y
    inside = np.clip(inside_share, 1e-6, most)
    log_range = log(most / inside)
    way_areas = [2.0 * room_y * width / most_y, 2.0 * room_x * height / most_x, 4.0 * width * height * log_range]
    way_ends = np.cumsum(np.stack(way_areas, axis=1), axis=1)
    way = (way_choice[:, None] * way_ends[:, 2:] >= way_ends[:, :2]).sum(axis=1)
    cuts_x, cuts_y, at_corner = way != 1, way != 0, way == 2

    # One number has which of the four corners or two sides is cut, and how deep along a corner.
    quarter, depth = np.divmod(side_choice * 4.0, 1.0)
    corner_x = most_x * exp(-log_range * depth)
    inside_x = np.where(at_corner, corner_x, inside / most_y)
    inside_y = np.where(at_corner, inside / corner_x, inside / most_x)
    return _Cuts(
        is_cut=np.stack([cuts_x, cuts_y], axis=1) & (inside < most)[:, None],
        at_high=np.stack([quarter % 2 == 1, quarter // 2 == 1], axis=1),
        inside=np.stack([inside_x, inside_y], axis=1),
    )
