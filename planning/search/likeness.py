"""The photograph that each image follows, and what its box asks of cameras.

Half of an image's tries follow its sampled photograph, so that boxes that are hard to reproduce stay frequent. Each try
of the third quarter samples another one with a box of about that height, so that refused boxes don't change the
distribution of heights. The last quarter follows the configured ranges.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.base.errors import ConfigError
from hulldown.base.portable import exp, hypot, log, sin_cos
from hulldown.base.uniform import GOLDEN_RATIO
from hulldown.camera.cameras import Cameras
from hulldown.camera.framing import pan_center_to_pixel, turn_cameras_to_boxes
from hulldown.camera.intrinsics import Intrinsics
from hulldown.camera.shell import camera_pose, outward_and_camera_axes, sample_azimuths, sample_elevations
from hulldown.dataset.photographs import Photographs
from hulldown.geometry.transforms import BOX_CORNERS, rotate_vectors
from hulldown.plan.config.scene_sections import CameraSection
from hulldown.plan.config.schema import Config
from hulldown.planning.search.instance_table import Instances, fit_cameras_to_sizes, posed_hull_vertices
from hulldown.planning.search.random_streams import Purpose, RandomStreams, RowStreams, choose_weighted_indices
from hulldown.planning.search.stage import Fleet

MIN_CLASS_BOXES = 20  # with fewer boxes of a class, those of all classes are used
MAX_CORNER_CUT_SHARE = 0.5  # of a box's height that is assumed to be cut off over a corner of the photograph
# Of the largest `truncated_fraction`, aimed for: what the frame leaves fills less than its share of the box.
TRUNCATION_MARGIN = 0.8
MAX_RANK = np.nextafter(1.0, 0.0)
QUARTER_PLACES = 10  # places without a camera that count as a quarter of an image's tries
MIN_STEEP_RADIANS = math.radians(15.0)  # elevation from which level ground tells a companion's distance better than its box
MIN_RAY_FALL_SHARE = 0.05  # of the length of a ray that's followed to the ground
DIRECTIONS_PER_CAMERA = 24
MIN_ASPECT_TOLERANCE = 0.03  # relative: no vehicle has exactly the sampled aspect ratio
MAX_DISTANCE_RATIO = 2.0  # estimated distances are wrong by at most this factor


class Following(IntEnum):
    """What a try of a camera follows."""

    RANGES = 0  # the configured ranges
    INSTEAD = 1  # the configured ranges, since the photograph that was sampled for the image can't be followed
    PHOTOGRAPH = 2


@dataclass(frozen=True, eq=False, slots=True)
class TargetBoxes:
    """Boxes of photographs that n tries of cameras should reproduce."""

    sampled: Int[np.ndarray, " n"]  # the box that was sampled for the image
    box: Int[np.ndarray, " n"]  # the box that this try may follow
    following: UInt8[np.ndarray, " n"]  # a `Following`
    corners: Float[np.ndarray, "n 4"]  # its left, top, right, and bottom side in pixels
    cut: Bool[np.ndarray, "n 4"]  # whether the frame cuts it off at this side
    wide: Bool[np.ndarray, " n"]  # whether its width counts, since the frame cuts off its height
    pixels: Float[np.ndarray, " n"]  # height of the target's box, or its width if `wide`
    kept: Float[np.ndarray, " n"]  # share of the height that a cut over a corner of the photograph leaves
    aspect: Float[np.ndarray, " n"]  # width over height of the box without that cut
    choice: Float[np.ndarray, " n"]  # uniform numbers in [0, 1) that choose directions

    def least_kept_shares(self, most_truncated: float) -> Float[np.ndarray, "n 2"]:
        """Return least shares of targets' widths and heights in the frame, by the largest `truncated_fraction`."""
        share = np.minimum((1.0 - TRUNCATION_MARGIN * most_truncated) / self.kept, 1.0)
        horizontal_cut, _ = axis_cut_masks(self.cut)
        return np.stack([np.where(horizontal_cut, share, 0.0), np.where(horizontal_cut, 0.0, share)], axis=1)


@dataclass(frozen=True, eq=False, slots=True)
class PhotographedPoses:
    """Places and headings of n companions in photographs, relative to targets."""

    xy_yaw: Float[np.ndarray, "n 3"]  # on level ground: meters from the target, and radians
    is_shown: Bool[np.ndarray, " n"]  # whether the photograph shows this companion


class Likeness:
    """Boxes of photographs to sample from, within the limits of a config."""

    def __init__(self, photographs: Photographs, config: Config) -> None:
        self.photographs, self.camera, self.placement = photographs, config.camera, config.placement
        self.image_size = np.array([config.render.width, config.render.height], dtype=np.float64)
        self.usable, self.unused = usable_mask_and_refusals(photographs, config.camera, config.render.height)
        if not self.usable.any():
            why = ", ".join(f"{n:,} {reason}" for reason, n in self.unused.items()) or "it has none"
            raise ConfigError(
                f"camera.like: no box of {photographs.path} can be used: {why}",
                path=config.path,
                remedy="widen these limits, or name other photographs",
            )
        # A photograph's boxes share a weight of 1, or more if it has more boxes than an image can have vehicles.
        shown = np.minimum(photographs.count, config.placement.vehicles_per_image[1])[photographs.image]
        self._weights = np.where(self.usable, 1.0 / np.maximum(shown, 1), 0.0)
        self._by_height = np.argsort(photographs.height, kind="stable")
        classes = np.array(photographs.class_names, dtype=object)[photographs.class_index]
        self._boxes = Counter(classes[self.usable].tolist())
        enough = [category for category, n in self._boxes.items() if n >= MIN_CLASS_BOXES]
        self._own = {category: np.where(classes == category, self._weights, 0.0) for category in enough}

    def box_usability_notes(self, categories: Iterable[str]) -> list[str]:
        """Return a line for each kind of unused boxes, and for each class with too few boxes."""
        path, n = self.photographs.path, len(self.usable)
        notes = [f"{path}: {count:,} of {n:,} boxes aren't followed: they {why}" for why, count in self.unused.items()]
        for category in sorted(categories):
            count = self._boxes[category]
            if count < MIN_CLASS_BOXES:
                boxes = f"only {count:,} boxes" if count else "no box"
                notes.append(f"{path}: {boxes} of class {category!r} to follow: its targets follow those of all classes")
        return notes

    def sample_boxes_with_follow_mask(
        self, draws: RandomStreams, fleet: Fleet, *, model: Int[np.ndarray, " n"], image: Int[np.ndarray, " n"]
    ) -> tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Sample a box for each image, by its target's model; return whether images follow it too."""
        share, rank = draws.uniform(Purpose.LIKE, image, 0, count=2).T
        return self._boxes_at_ranks(fleet, model, rank), share < self.camera.like_share

    def _boxes_at_ranks(
        self, fleet: Fleet, model: Int[np.ndarray, " n"], rank: Float[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
        box = np.zeros(len(model), dtype=np.int64)
        for index in np.unique(model).tolist():
            weights = self._own.get(fleet.models[index].category or "", self._weights)
            rows = np.flatnonzero(model == index)
            box[rows] = self._by_height[choose_weighted_indices(weights[self._by_height], rank[rows])]
        return box

    def _boxes_of_similar_height(
        self, draws: RandomStreams, targets: Instances, *, image: Int[np.ndarray, " n"], uniform: Float[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
        """Return boxes of about the height of the sampled ones: half of them within an eighth of all ranks."""
        rank = np.abs(draws.uniform(Purpose.LIKE, image, 0, count=2)[:, 1] + (2.0 * uniform - 1.0) ** 3)
        reflected = np.where(rank < 1.0, rank, 2.0 - rank).clip(0.0, MAX_RANK)  # at both ends
        return self._boxes_at_ranks(targets.fleet, targets.model, reflected)

    def companion_counts(self, box: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Return the number of other boxes in the photograph of each box."""
        return self.photographs.count[self.photographs.image[box]] - 1

    def sample_target_boxes(
        self,
        draws: RandomStreams,
        targets: Instances,
        *,
        image: Int[np.ndarray, " n"],
        attempt: Int[np.ndarray, " n"],
        quarter: Int[np.ndarray, " n"],
    ) -> TargetBoxes:
        """Return the boxes that n tries may follow, varied by `camera.like_spread`; `quarter` as in the module's docstring."""
        sampled, follows_photograph = self.sample_boxes_with_follow_mask(draws, targets.fleet, model=targets.model, image=image)
        uniform = draws.uniform(Purpose.LIKE, image, 1 + attempt, count=6)
        box_choice, variation, corner_cut, direction_choice = np.split(uniform, (1, 4, 5), axis=1)
        nearby = self._boxes_of_similar_height(draws, targets, image=image, uniform=box_choice[:, 0])
        box = np.where(quarter < 2, sampled, nearby)
        low, extent = self._varied_corners_and_sizes(box, self.camera.like_spread * (2.0 * variation - 1.0))
        cut = self.photographs.cut[box]
        horizontal_cut, vertical_cut = axis_cut_masks(cut)
        kept = self._kept_height_shares(horizontal_cut & vertical_cut, corner_cut[:, 0])
        wide = vertical_cut & ~horizontal_cut
        by_quarter = np.where(quarter < 3, Following.PHOTOGRAPH, Following.INSTEAD)
        return TargetBoxes(
            sampled=sampled,
            box=box,
            following=np.where(follows_photograph, by_quarter, Following.RANGES).astype(np.uint8),
            corners=np.concatenate([low, low + extent], axis=1),
            cut=cut,
            wide=wide,
            pixels=np.where(wide, extent[:, 0], extent[:, 1] / kept),  # of the target, which a corner's cut doesn't shorten
            kept=kept,
            aspect=self.photographs.aspect[box] * kept,
            choice=direction_choice[:, 0],
        )

    def _varied_corners_and_sizes(
        self, box: Int[np.ndarray, " n"], change: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
        """Return upper left corners and sizes of boxes in pixels, changed in height, x, and y by shares of the box."""
        photographs, size = self.photographs, self.image_size
        # The box keeps its shape if the image's differs from the photograph's.
        height = photographs.height[box] * size[1] * (1.0 + change[:, 0])
        extent = np.stack([photographs.aspect[box] * height, height], axis=1)
        low = (photographs.center[box] + photographs.relative[box, 2:] * change[:, 1:]) * size - extent / 2.0
        # A side at the frame stays there; the opposite one moves with the size.
        cut_low, cut_high = np.split(photographs.cut[box], 2, axis=1)
        return np.where(cut_low, 0.0, np.where(cut_high, size - extent, low)), extent

    def _kept_height_shares(
        self, over_corner: Bool[np.ndarray, " n"], uniform: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Draw the share of the height that is left of boxes over a corner of the photograph; 1 for others."""
        most_truncated = TRUNCATION_MARGIN * self.camera.truncated_fraction[1]
        largest_cut = min(MAX_CORNER_CUT_SHARE, 1.0 - math.sqrt(1.0 - most_truncated))
        return np.where(over_corner, 1.0 - largest_cut * uniform, 1.0)


def axis_cut_masks(cut: Bool[np.ndarray, "n 4"]) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Return whether frames cut boxes off on their left or right, and at their top or bottom; `cut`: as in `TargetBoxes`."""
    left, top, right, bottom = cut.T
    return left | right, top | bottom


def usable_mask_and_refusals(
    photographs: Photographs, camera: CameraSection, image_height: int
) -> tuple[Bool[np.ndarray, " n"], Counter[str]]:
    """Return whether each box is within the cameras' limits, and the numbers of the other boxes by reason."""
    pixels = photographs.height * image_height
    cut, (least, most) = photographs.cut.any(axis=1), camera.truncated_fraction
    unused = {
        "are smaller than camera.min_box_px": pixels * np.minimum(photographs.aspect, 1.0) < camera.min_box_px,
        "are cut off more than camera.truncated_fraction": cut & (most == 0.0),
        "are cut off less than camera.truncated_fraction": ~cut & (least > 0.0),
    }
    refused = np.zeros(len(pixels), dtype=bool)
    counts = Counter[str]()
    for reason, rows in unused.items():
        counts[reason] = int(np.count_nonzero(rows & ~refused))
        refused |= rows
    return ~refused, +counts


def direction_streams(draws: RandomStreams, image: Int[np.ndarray, " n"], attempt: Int[np.ndarray, " n"]) -> RowStreams:
    """Return the random numbers for the candidate directions of these tries."""
    tries = attempt[:, None] * DIRECTIONS_PER_CAMERA + np.arange(DIRECTIONS_PER_CAMERA)
    return RowStreams(draws, Purpose.DIRECTION, np.repeat(image, DIRECTIONS_PER_CAMERA), tries.ravel())


def fit_cameras_to_boxes(
    targets: Instances,
    boxes: TargetBoxes,
    limits: CameraSection,
    *,
    lenses: Intrinsics,
    roll: Float[np.ndarray, " n"],
    rng: RowStreams,
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, " n"]]:
    """Return cameras that reproduce size and place of photographs' boxes, and their distances; nan without one."""
    n = len(targets)
    azimuth, elevation, distance = choose_directions_and_distances(targets, boxes, limits, lenses=lenses, rng=rng)
    poses = np.full((n, 4, 4), np.nan)
    least, most = limits.distance_m
    # Estimated distances far beyond the limits are rejected without solving.
    possible = np.flatnonzero((distance > least / MAX_DISTANCE_RATIO) & (distance < most * MAX_DISTANCE_RATIO))
    for model, of_model in targets.take(possible).indices_by_model():
        of_model = possible[of_model]
        hull = posed_hull_vertices(model, targets.world_from_vehicle[of_model], targets.model_angles(model, of_model))
        for wide in (False, True):
            chosen = boxes.wide[of_model] == wide
            i = of_model[chosen]
            if not len(i):
                continue
            frame = partial(
                turn_cameras_to_boxes,
                points_world=hull[chosen],
                corners=boxes.corners[i],
                cut=boxes.cut[i],
                kept=boxes.least_kept_shares(limits.truncated_fraction[1])[i],
                roll=roll[i],
            )
            poses[i], distance[i] = fit_cameras_to_sizes(
                targets.take(i),
                hull[chosen],
                lenses=lenses.take(i),
                pixels=boxes.pixels[i],
                measure="width" if wide else "height",
                azimuth=azimuth[i],
                elevation=elevation[i],
                roll=roll[i],
                frame=frame,
            )
    return poses, distance


def choose_directions_and_distances(
    targets: Instances, boxes: TargetBoxes, limits: CameraSection, *, lenses: Intrinsics, rng: RowStreams
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Sample configured elevations, choose azimuths by how well the aspect ratio fits, and estimate the distance."""
    n = len(targets)
    low, high = (math.radians(angle) for angle in limits.elevation_deg)
    azimuth = sample_azimuths(n * DIRECTIONS_PER_CAMERA, rng=rng).reshape(n, DIRECTIONS_PER_CAMERA)
    elevation = sample_elevations(n * DIRECTIONS_PER_CAMERA, (low, high), rng=rng, uniform_in=limits.elevation_sampling)
    elevation = np.repeat(elevation.reshape(n, DIRECTIONS_PER_CAMERA)[:, :1], DIRECTIONS_PER_CAMERA, axis=1)
    axes = outward_and_camera_axes(azimuth, elevation)[1]
    local = targets.part_box_corners() - targets.centers_in_world[:, None]
    # Explicit sums, which have the same bits on every processor.
    x, y, depth = (
        local[:, None, :, 0] * axes[..., None, 0, axis]
        + local[:, None, :, 1] * axes[..., None, 1, axis]
        + local[:, None, :, 2] * axes[..., None, 2, axis]
        for axis in range(3)
    )
    measured = np.where(boxes.wide[:, None], np.ptp(x, axis=2), np.ptp(y, axis=2))
    # Perspective changes the aspect ratio of near targets: apply it at about the wanted size.
    distance = measured * lenses.focal[..., 1:] / boxes.pixels[:, None]
    scale = 1.0 / np.maximum(distance[..., None] + depth, 0.1 * distance[..., None])
    misfit = log(np.ptp(x * scale, axis=2) / np.ptp(y * scale, axis=2)) - log(boxes.aspect)[:, None]
    across, down = (mask[:, None] for mask in axis_cut_masks(boxes.cut))
    # Where the frame cuts off the width, a target is longer than its box, and taller where it cuts off the height: as
    # much as `truncated_fraction` allows.
    longer = np.maximum(log(boxes.kept / (1.0 - TRUNCATION_MARGIN * limits.truncated_fraction[1])), 0.0)[:, None]
    misfit -= np.where(across, np.clip(misfit, 0.0, longer), 0.0)
    misfit -= np.where(down & ~across, np.clip(misfit, -longer, 0.0), 0.0)
    row, chosen = np.arange(n), choose_fitting_direction(misfit, limits, boxes.choice)
    return azimuth[row, chosen], elevation[row, chosen], distance[row, chosen]


def choose_fitting_direction(
    misfit: Float[np.ndarray, "n d"], limits: CameraSection, choice: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """Choose a direction for each row by its misfits of logarithmic aspect ratios, with numbers in [0, 1)."""
    exponent = -0.5 * (misfit / max(limits.like_spread / 2.0, MIN_ASPECT_TOLERANCE)) ** 2
    return choose_weighted_indices(exp(exponent - exponent.max(axis=1, keepdims=True)), choice)


def companion_poses(
    likeness: Likeness,
    targets: Instances,
    others: Instances,
    boxes: TargetBoxes,
    *,
    number: Int[np.ndarray, " n"],
    lenses: Intrinsics,
    rng: RowStreams,
) -> PhotographedPoses:
    """Return places on the rays through boxes' centers, and headings, where companions fill photographs' boxes."""
    photographs, limits = likeness.photographs, likeness.camera
    poses = np.zeros((len(number), 3))
    azimuth, elevation, distance = choose_directions_and_distances(targets, boxes, limits, lenses=lenses, rng=rng)
    uniform = rng.random((len(number) * DIRECTIONS_PER_CAMERA,)).reshape(-1, DIRECTIONS_PER_CAMERA)
    # Companions of an image have the same random numbers.
    yaw = 2.0 * math.pi * (uniform + GOLDEN_RATIO * number[:, None])
    is_shown = (boxes.following == Following.PHOTOGRAPH) & (number < likeness.companion_counts(boxes.box))
    has = np.flatnonzero(is_shown)
    start = np.searchsorted(photographs.image, photographs.image[boxes.box])
    box, of_target = (start + number + (start + number >= boxes.box))[has], boxes.box[has]
    distance, yaw, lenses = distance[has], yaw[has], lenses.take(has)
    size, tall = (each.fleet.size[each.model[has]] for each in (others, targets))

    # Relative to the target's center, with the target where its box is.
    level = camera_pose(np.zeros((len(has), 3)), distance, azimuth[has], elevation[has])
    turn = pan_center_to_pixel(Cameras(lenses, level), photographs.center[of_target] * lenses.size).world_from_camera[:, :3, :3]
    ray = rotate_vectors(turn, lenses.pixel_directions((photographs.center[box] * lenses.size)[:, None]))[:, 0]
    ray /= np.sqrt((ray * ray).sum(axis=1, keepdims=True))
    by_height = distance * size[:, 2] / tall[:, 2] * photographs.height[of_target] / photographs.height[box]
    to_ground = (level[:, 2, 3] + (tall[:, 2] - size[:, 2]) / 2.0) / np.maximum(-ray[:, 2], MIN_RAY_FALL_SHARE)
    steep = (elevation[has] > MIN_STEEP_RADIANS) & (ray[:, 2] < -MIN_RAY_FALL_SHARE)
    away = np.where(steep, to_ground, by_height)[:, None] * ray

    sy, cy = (part[..., None] for part in sin_cos(yaw))
    x, y, z = np.moveaxis(BOX_CORNERS * (size[:, None] / 2.0), 2, 0)[:, :, None]
    corners = np.stack(np.broadcast_arrays(cy * x - sy * y, sy * x + cy * y, z), axis=-1) + away[:, None, None]
    right, down, ahead = np.moveaxis(corners @ turn[:, None], 3, 0)
    ahead = np.maximum(ahead, 0.1 * distance[:, None, None])
    aspect = np.ptp(right / ahead, axis=2) / np.ptp(down / ahead, axis=2)
    whole = ~photographs.cut[box].any(axis=1, keepdims=True)
    misfit = np.where(whole, log(aspect) - log(photographs.aspect[box])[:, None], 0.0)
    poses[has, 2] = yaw[np.arange(len(has)), choose_fitting_direction(misfit, limits, boxes.choice[has])]

    xy = level[:, :2, 3] + away[:, :2]
    length = np.maximum(hypot(xy[:, 0], xy[:, 1]), 1e-9)
    poses[has, :2] = xy * (np.clip(length, *likeness.placement.companion_distance) / length)[:, None]
    return PhotographedPoses(poses, is_shown)
