"""Which photograph each image follows, and cameras that see a target as the photograph shows its own.

An image keeps its photograph for half of a place's tries, so that boxes that are hard to reproduce stay as frequent as
they are. Then every try takes another photograph, and the last quarter follows the configured ranges.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.assets.photographs import Photographs
from hulldown.camera.framing import place_boxes
from hulldown.camera.lenses import Lenses
from hulldown.camera.shell import draw_azimuth, draw_elevation, shell_axes
from hulldown.geometry.errors import ConfigError
from hulldown.geometry.portable import exp, hypot, log, sin_cos
from hulldown.planning.config.schema import Config
from hulldown.planning.search.draws import Purpose, RandomStreams, RowStreams
from hulldown.planning.search.instances import Instances, hull_of
from hulldown.planning.search.sizing import sized_cameras
from hulldown.planning.search.stage import Fleet

FEW = 20  # boxes of a class, below which those of all classes are used
DIRECTIONS = 24  # looked at for each camera
LEAST_TOLERANCE = 0.03  # of aspect ratios, relative: no vehicle has exactly the sampled one
HALF_CUT = 0.5  # of a box over a corner at most this share of the height is cut off: the photograph doesn't tell
SLACK = 2.0  # of estimated distances
PATIENCE = 10  # places without a view that count as much as a quarter of a place's tries


@dataclass(frozen=True, eq=False, slots=True)
class Wishes:
    """What n tries of cameras are to reproduce.

    Parameters
    ----------
    asked, box
        (n,) box of the photographs that was sampled for the image, and the one that this try follows; -1: none.
    corners
        (n, 4) left, top, right, and bottom side of the box in the frame, pixels.
    cut
        (n, 4) whether the frame cuts it off there.
    pixels
        (n,) height that the target's box is to have, or width where that is `wide`.
    wide
        (n,) whether the frame cuts off the height.
    aspect
        (n,) width over height of the box, as far as the frame doesn't cut it off.
    choice
        (n,) uniform numbers in [0, 1), by which directions are chosen.
    """

    asked: Int[np.ndarray, " n"]
    box: Int[np.ndarray, " n"]
    corners: Float[np.ndarray, "n 4"]
    cut: Bool[np.ndarray, "n 4"]
    pixels: Float[np.ndarray, " n"]
    wide: Bool[np.ndarray, " n"]
    aspect: Float[np.ndarray, " n"]
    choice: Float[np.ndarray, " n"]


class Likeness:
    """The photographs of a config, ready to be sampled.

    Parameters
    ----------
    photographs
        Their boxes.
    config
        Whose limits decide which of them are used.

    Raises
    ------
    ConfigError
        If the limits leave no box.
    """

    def __init__(self, photographs: Photographs, config: Config) -> None:
        self.photographs, self.config = photographs, config
        self.usable, self.unused = usable_boxes(photographs, config)
        if not self.usable.any():
            why = ", ".join(f"{n:,} {reason}" for reason, n in self.unused.items()) or "it has none"
            raise ConfigError(
                f"camera.like: no box of {photographs.path} can be used: {why}",
                path=config.path,
                remedy="widen these limits, or name other photographs",
            )
        # Of a photograph with many boxes as many become targets as the others can't show as companions.
        shown = np.minimum(photographs.count, config.placement.vehicles_per_image[1])[photographs.image]
        self._weights = np.where(self.usable, 1.0 / np.maximum(shown, 1), 0.0)
        classes = np.array(photographs.category, dtype=object)
        self._all = np.cumsum(self._weights)
        self._own: dict[str, Float[np.ndarray, " n"]] = {}
        self._boxes = Counter(classes[self.usable].tolist())
        for category, n in self._boxes.items():
            if n >= FEW:
                self._own[category] = np.cumsum(np.where(classes == category, self._weights, 0.0))

    def notes(self, categories: Iterable[str]) -> list[str]:
        """Boxes and classes that are not followed as one would expect, a line each."""
        path, n = self.photographs.path, len(self.usable)
        notes = [f"{path}: {count:,} of {n:,} boxes aren't followed: they {why}" for why, count in self.unused.items()]
        for category in sorted(categories):
            own = self._boxes[category]
            if own < FEW:
                found = f"only {own:,} boxes" if own else "no box"
                notes.append(
                    f"{path}: {found} of class {category!r} to follow: its targets follow those of all classes"
                )
        return notes

    def sampled(
        self, draws: RandomStreams, fleet: Fleet, *, model: Int[np.ndarray, " n"], image: Int[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
        """The box that each image is to follow, by its target's model; -1: it follows the configured ranges."""
        uniform = draws.uniform(Purpose.LIKE, image, 0, count=2)
        return np.where(uniform[:, 0] < self.config.camera.like_share, self._picked(fleet, model, uniform[:, 1]), -1)

    def _picked(
        self, fleet: Fleet, model: Int[np.ndarray, " n"], uniform: Float[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
        """Boxes of each model's class, or of all if there are few, in proportion to numbers in [0, 1)."""
        box = np.zeros(len(model), dtype=np.int64)
        for one in np.unique(model).tolist():
            running, rows = self._own.get(fleet.models[one].category or "", self._all), np.flatnonzero(model == one)
            box[rows] = np.searchsorted(running, uniform[rows] * running[-1], side="right")
        return np.minimum(box, np.flatnonzero(self.usable)[-1])

    def companions(self, box: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """How many other boxes the photograph of each box has; -1 without a box."""
        known = self.photographs
        return np.where(box >= 0, known.count[known.image[box]] - 1, -1)

    def places_beside(
        self,
        targets: Instances,
        others: Instances,
        wishes: Wishes,
        *,
        number: Int[np.ndarray, " n"],
        lens: Lenses,
        rng: RowStreams,
    ) -> Float[np.ndarray, "n 2"]:
        """Where level ground shows companions as large and where the photographs of their targets have other boxes.

        Parameters
        ----------
        targets, others
            n pairs of a target and a companion, whose pose doesn't matter.
        wishes, lens, rng
            Of the first try of each target's camera; see `matching_cameras`.
        number
            (n,) the how manieth companion each is.

        Returns
        -------
        (n, 2) meters from targets to companions in x and y, within `placement.companion_distance`; nan where the
        photograph has no box for it.
        """
        known, (least, most) = self.photographs, self.config.placement.companion_distance
        has = np.flatnonzero(number < self.companions(wishes.box))
        places = np.full((len(number), 2), np.nan)
        start = np.searchsorted(known.image, known.image[wishes.box])
        box = (start + number + (start + number >= wishes.box))[has]
        azimuth, elevation, distance = _directions(targets, wishes, self.config, lens=lens, rng=rng)
        (sa, ca), (se, ce), near = sin_cos(azimuth[has]), sin_cos(elevation[has]), distance[has]
        tall = (others.fleet.size[others.model, 2] / targets.fleet.size[targets.model, 2])[has]
        far = near * tall * known.height[wishes.box[has]] / known.height[box]
        away = (known.center[box] - known.center[wishes.box[has]]) * lens.size[has] / lens.focal[has] * far[:, None]
        right, ahead = away[:, 0], (far - near) * ce - away[:, 1] * se
        xy = np.stack([-sa * right - ca * ahead, ca * right - sa * ahead], axis=1)
        length = np.maximum(hypot(xy[:, 0], xy[:, 1]), 1e-9)
        places[has] = xy * (np.clip(length, least, most) / length)[:, None]
        return places

    def wishes(
        self,
        draws: RandomStreams,
        targets: Instances,
        *,
        image: Int[np.ndarray, " n"],
        attempt: Int[np.ndarray, " n"],
        quarter: Int[np.ndarray, " n"],
    ) -> Wishes:
        """What n tries follow.

        Parameters
        ----------
        draws
            The plan's numbers.
        targets
            Of the tries.
        image, attempt
            Of each try.
        quarter
            (n,) 0 to 3, how much of the image's tries is used up.
        """
        camera, render, known = self.config.camera, self.config.render, self.photographs
        again = draws.uniform(Purpose.LIKE, image, 1 + attempt, count=6)
        asked = self.sampled(draws, targets.fleet, model=targets.model, image=image)
        box = np.where(quarter < 2, asked, self._picked(targets.fleet, targets.model, again[:, 0]))
        box = np.where((asked >= 0) & (quarter < 3), box, -1)
        size, cut = np.array([render.width, render.height], dtype=np.float64), known.cut[box]
        deviation = camera.like_spread * (2.0 * again[:, 1:4] - 1.0)
        height, aspect = known.height[box] * size[1] * (1.0 + deviation[:, 0]), known.aspect[box]
        extent = np.stack([aspect * height, height], axis=1)  # pictures of another format keep the shape of the box
        low = (known.center[box] + known.xywh[box, 2:] * deviation[:, 1:]) * size - extent / 2.0
        cut_low, cut_high = cut[:, :2], cut[:, 2:]
        # A side that the frame cuts off stays at the frame; the opposite one moves as the size does.
        low = np.where(cut_low, 0.0, np.where(cut_high, size - extent, low))
        across, down = (cut_low | cut_high).T
        wide = down & ~across
        kept = np.where(down & across, 1.0 - HALF_CUT * again[:, 4], 1.0)
        return Wishes(
            asked,
            box,
            np.concatenate([low, low + extent], axis=1),
            cut,
            np.where(wide, extent[:, 0], height / kept),
            wide,
            aspect * kept,
            again[:, 5],
        )


def usable_boxes(photographs: Photographs, config: Config) -> tuple[Bool[np.ndarray, " n"], Counter[str]]:
    """Whether the config's limits allow each box, and how many they don't, by reason."""
    camera = config.camera
    pixels = photographs.height * config.render.height
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


def directions_of(draws: RandomStreams, image: Int[np.ndarray, " n"], attempt: Int[np.ndarray, " n"]) -> RowStreams:
    """What the directions of these tries are drawn from."""
    tries = attempt[:, None] * DIRECTIONS + np.arange(DIRECTIONS)
    return RowStreams(draws, Purpose.DIRECTION, np.repeat(image, DIRECTIONS), tries.ravel())


def matching_cameras(
    targets: Instances, wishes: Wishes, config: Config, *, lens: Lenses, roll: Float[np.ndarray, " n"], rng: RowStreams
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, " n"]]:
    """Cameras that show each target as large and where its photograph does, and their distances; nan where none can.

    Parameters
    ----------
    targets
        n of them.
    wishes
        n of them, each with a box.
    config
        Whose elevations are drawn.
    lens, roll
        Of the n cameras.
    rng
        What the directions of the cameras are drawn from; see `directions_of`.
    """
    n = len(targets)
    azimuth, elevation, distance = _directions(targets, wishes, config, lens=lens, rng=rng)
    poses = np.full((n, 4, 4), np.nan)
    least, most = config.camera.distance_m
    # What is far beyond the limits isn't solved: an estimate is enough to refuse it.
    possible = np.flatnonzero((distance > least / SLACK) & (distance < most * SLACK))
    for model, of_model in targets.take(possible).by_model():
        of_model = possible[of_model]
        hull = hull_of(model, targets.world_from_vehicle[of_model], targets.model_angles(model, of_model))
        for wide in (False, True):
            chosen = wishes.wide[of_model] == wide
            i = of_model[chosen]
            if not len(i):
                continue
            framed = partial(
                place_boxes,
                points_world=hull[chosen],
                intrinsics=lens.rows(i),
                corners=wishes.corners[i],
                cut=wishes.cut[i],
                roll=roll[i],
            )
            poses[i], distance[i] = sized_cameras(
                targets.take(i),
                hull[chosen],
                lens=lens.rows(i),
                pixels=wishes.pixels[i],
                measure="width" if wide else "height",
                azimuth=azimuth[i],
                elevation=elevation[i],
                roll=roll[i],
                framed=framed,
            )
    return poses, distance


def _directions(
    targets: Instances, wishes: Wishes, config: Config, *, lens: Lenses, rng: RowStreams
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Azimuth, elevation, and estimated distance of each camera: of several, by how well the aspect ratio fits."""
    n, limits = len(targets), config.camera
    low, high = (math.radians(angle) for angle in limits.elevation_deg)
    azimuth = draw_azimuth(n * DIRECTIONS, rng=rng).reshape(n, DIRECTIONS)
    elevation = draw_elevation(n * DIRECTIONS, (low, high), rng=rng, uniform_in=limits.elevation_sampling)
    elevation = elevation.reshape(n, DIRECTIONS)
    axes = shell_axes(azimuth, elevation)[1]
    local = targets.corners() - targets.centers[:, None]
    x, y, depth = (sum(local[:, None, :, k] * axes[..., None, k, axis] for k in range(3)) for axis in range(3))
    measured = np.where(wishes.wide[:, None], np.ptp(x, axis=2), np.ptp(y, axis=2))
    # Perspective counts where a target is near: once at the distance at which it has about the wanted size.
    distance = measured * lens.focal[:, 1:] / wishes.pixels[:, None]
    scale = 1.0 / np.maximum(distance[..., None] + depth, 0.1 * distance[..., None])
    misfit = log(np.ptp(x * scale, axis=2) / np.ptp(y * scale, axis=2)) - log(wishes.aspect)[:, None]
    across, down = (wishes.cut[:, :2] | wishes.cut[:, 2:]).T[..., None]
    # What the frame cuts off is unknown: a target may be longer where its width is cut, and taller where its height is.
    misfit = np.where(across, np.minimum(misfit, 0.0), misfit)
    misfit = np.where(down & ~across, np.maximum(misfit, 0.0), misfit)
    exponent = -0.5 * (misfit / max(limits.like_spread / 2.0, LEAST_TOLERANCE)) ** 2
    weight = np.cumsum(exp(exponent - exponent.max(axis=1, keepdims=True)), axis=1)
    wanted = wishes.choice[:, None] * weight[:, -1:]
    row, chosen = np.arange(n), np.minimum((weight <= wanted).sum(axis=1), DIRECTIONS - 1)
    return azimuth[row, chosen], elevation[row, chosen], distance[row, chosen]
