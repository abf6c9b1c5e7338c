"""Tables of the search: a block of positions on one scenery, planned together, its instances, and their views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from hulldown.annotate.boxes import Boxes
from hulldown.base.columns import take
from hulldown.base.indices import group_and_rank
from hulldown.base.portable import sin_cos
from hulldown.camera.cameras import Cameras
from hulldown.camera.intrinsics import Intrinsics
from hulldown.placement.settle import Settled, empty_settled
from hulldown.plan.config.scene_sections import WeatherSection
from hulldown.plan.config.schema import Config
from hulldown.plan.rejection import Rejection
from hulldown.plan.row import round_field
from hulldown.planning.search.budget import Budget, Given, Positions, empty_given_poses
from hulldown.planning.search.instance_table import Instances, articulated_bounds, nan_boxes, part_angles_from_uniform
from hulldown.planning.search.likeness import Likeness, TargetBoxes
from hulldown.planning.search.random_streams import Purpose, RandomStreams, choose_weighted_indices, scale_uniform
from hulldown.planning.search.stage import PlanStage, Site
from hulldown.weather.extinction import rain_visibility_m, surface_wetness
from hulldown.weather.kinds import WEATHER_KINDS, Weather

MAX_ROLE_EXTRAS = 64  # in an image; streams of random numbers are numbered by it
MAX_EXTRA_TURNS = 64  # parts of an extra, the hull included, that turn; further ones stay at their lower limits
WEATHER_NAMES = tuple(WEATHER_KINDS)
CLEAR_WEATHER = len(WEATHER_NAMES)


class InstanceRole(IntEnum):
    """The role of an instance; roles are placed in this order."""

    TARGET = 0
    COMPANION = 1
    DISTRACTOR = 2


@dataclass(frozen=True, eq=False, slots=True)
class Extras:
    """The companions or distractors that may be at a position."""

    role: InstanceRole
    models: Int[np.ndarray, " m"]  # models, weights: candidates as indices in the fleet, and their weights
    weights: Float[np.ndarray, " m"]
    count: tuple[int, int]  # least and largest number in an image

    def sample_extra_columns(
        self,
        draws: RandomStreams,
        position: Int[np.ndarray, " n"],
        *,
        wanted: Int[np.ndarray, " n"],
        is_wanted: Bool[np.ndarray, " n"],
    ) -> tuple[Int[np.ndarray, " q"], Int[np.ndarray, " q"], Int[np.ndarray, " q"], Float[np.ndarray, "q 64"]]:
        """Draw extras: rows, numbers, models, uniform numbers for angles; as many as `wanted` where `is_wanted`."""
        low, high = self.count
        choice = Purpose.COMPANY if self.role == InstanceRole.COMPANION else Purpose.DISTRACTORS
        size = draws.uniform(choice, position, 0, count=1)[:, 0]
        count = low + np.minimum((size * (high - low + 1)).astype(np.int64), high - low)
        count = np.where(is_wanted, np.clip(wanted, low, high), count)
        uniform = draws.uniform(choice, position[:, None], 1 + np.arange(high), count=1 + MAX_EXTRA_TURNS)
        model = self.models[choose_weighted_indices(self.weights, uniform[..., 0])]
        row, rank = np.nonzero(np.arange(high) < count[:, None])
        return row, rank, model[row, rank], uniform[row, rank, 1:]


def scenery_extras_by_background(
    site: Site, stage: PlanStage, of_vehicles: Float[np.ndarray, " v"]
) -> dict[bool, list[Extras]]:
    """Return a scenery's companions, drawn by `of_vehicles`, and distractors, by whether they're for backgrounds."""
    limits, (least, most) = stage.config.placement, stage.config.placement.vehicles_per_image
    companions = Extras(InstanceRole.COMPANION, np.arange(stage.vehicle_count), of_vehicles, (least - 1, most - 1))
    extras: dict[bool, list[Extras]] = {False: [companions], True: []}
    for background, kinds in extras.items():
        models, weights = distractor_models_and_weights(site, stage, unlabeled=background)
        if weights.any():
            kinds.append(Extras(InstanceRole.DISTRACTOR, models, weights, limits.distractors_per_image))
    return extras


def distractor_models_and_weights(
    site: Site, stage: PlanStage, *, unlabeled: bool
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return all distractors and their weights on a scenery, 0 for those with a class if `unlabeled`."""
    weights = []
    for entry in stage.config.assets.distractors:
        weights.append(entry.weight if entry.allows_scenery(site.name) and not (unlabeled and entry.category) else 0.0)
    return stage.vehicle_count + np.arange(len(weights)), np.array(weights, dtype=np.float64)


def choose_target_models(
    budget: Budget, stage: PlanStage, draws: RandomStreams, *, positions: Positions, site: Site
) -> Int[np.ndarray, " n"]:
    """Return each position's framed model: for backgrounds a drawn vehicle, or a distractor without a class."""
    index = np.array([stage.fleet.index[name] for name in budget.vehicles])
    model, rows = index[positions.vehicle], np.flatnonzero(positions.background)
    uniform = draws.uniform(Purpose.BACKGROUND, positions.number[rows], 0, count=2)
    planned = budget.positions.vehicle[~budget.positions.background]
    shown = np.minimum((uniform[:, 0] * len(planned)).astype(np.int64), len(planned) - 1)
    model[rows] = index[planned[shown]]
    share, ordinal = stage.config.budget.background_distractors, positions.ordinal[rows]
    replaced = np.floor((ordinal + 1) * share) > np.floor(ordinal * share)
    models, weights = distractor_models_and_weights(site, stage, unlabeled=True)
    if weights.any():
        model[rows[replaced]] = models[choose_weighted_indices(weights, uniform[replaced, 1])]
    return model


def sample_weathers(weather: WeatherSection, *, draws: RandomStreams, image: Int[np.ndarray, " n"]) -> list[Weather | None]:
    """Draw the weather of images, rounded as in a plan, None where clear; kind and visibility by separate numbers."""
    u = draws.uniform(Purpose.LIGHT, image, 0, count=5)
    speed, turn, ground, vehicle = draws.uniform(Purpose.WEATHER, image, 0, count=4).T
    kind = np.searchsorted(np.cumsum([getattr(weather, name) for name in WEATHER_NAMES]), u[:, 3], side="right")

    def draw_in_range(key: str, uniform: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        low, high = getattr(weather, key)
        return scale_uniform(low, high, uniform)

    n = len(image)
    visible, rate, covers, windy = np.full(n, np.nan), np.zeros(n), np.zeros((2, n)), np.zeros(n, dtype=bool)
    for k, each in enumerate(WEATHER_KINDS.values()):
        rows = kind == k
        windy |= rows & each.windy
        if each.visibility:
            visible[rows] = draw_in_range(each.visibility, u[rows, 4])
        if each.rate:
            rate[rows] = round_field("weather", draw_in_range(each.rate, u[rows, 4]))
            visible[rows], covers[:, rows] = rain_visibility_m(rate[rows]), surface_wetness(rate[rows])
        for cover, key, uniform in zip(covers, each.covers, (ground, vehicle), strict=False):
            cover[rows] = draw_in_range(key, uniform[rows])
    sine, cosine = sin_cos(2.0 * np.pi * turn)
    wind = scale_uniform(*weather.wind_m_s, speed)[:, None] * np.stack([cosine, sine], axis=1)
    visible, wind = round_field("weather", visible), np.where(windy[:, None], round_field("weather", wind), 0.0)
    columns = (kind, visible, rate, wind, *round_field("weather", covers))
    return [
        None
        if k == CLEAR_WEATHER
        else Weather(visibility, WEATHER_NAMES[k], rain, (x, y), weather.exposure_s, on_ground, on_vehicle)
        for k, visibility, rain, (x, y), on_ground, on_vehicle in zip(*(c.tolist() for c in columns), strict=True)
    ]


class CameraRule(IntEnum):
    """What determines a camera's place in a try."""

    GIVEN = 0  # the user; the camera is then turned to frame the target, or to a given point
    EQUATION = 1  # the paper's distance; the camera is then turned to frame the target, or to a given point
    SIZE = 2  # a size of the target's box, with the target in frame
    PHOTOGRAPH = 3  # a photograph's box, which the target's box reproduces


@dataclass(frozen=True, eq=False, slots=True)
class CameraTries:
    """n tries of cameras; row i of every field belongs to try i."""

    targets: Instances
    others: Instances  # the vehicles beside the targets, by `Instances.row`
    given: Given  # what the user's poses give
    image: Int[np.ndarray, " n"]  # index of each try's image
    attempt: Int[np.ndarray, " n"]  # number of the try among those of its image
    quarter: Int[
        np.ndarray, " n"
    ]  # 0 to 3: quarters of an image's tries that are used up, by tries or by places without a camera
    visibility_m: Float[np.ndarray, " n"]  # nan in clear air


@dataclass(frozen=True, eq=False, slots=True)
class CameraDraws:
    """Random lenses, directions, and sizes of n tries of cameras."""

    lenses: Intrinsics  # one for all, or n
    azimuth: Float[np.ndarray, " n"]  # azimuth, elevation: direction from the target's center, radians
    elevation: Float[np.ndarray, " n"]
    roll: Float[np.ndarray, " n"]  # about the optical axis, radians
    fraction: Float[np.ndarray, " n"]  # share of the image that the target should fill
    factor: Float[np.ndarray, " n"]  # factor on the paper's distance
    boxes: TargetBoxes | None  # the boxes of photographs; None without photographs


@dataclass(frozen=True, eq=False, slots=True)
class CameraCandidates:
    """Cameras of n tries before they're checked."""

    drawn: CameraDraws
    rule: UInt8[np.ndarray, " n"]  # a `CameraRule`
    # level and aimed at the target's center by the first two rules, which are framed later; final by the others
    world_from_camera: Float[np.ndarray, "n 4 4"]
    distance: Float[np.ndarray, " n"]  # meters from the target's center
    has_distance: Bool[np.ndarray, " n"]  # whether a distance gives the wanted size; else pose and distance are unset

    def cameras(self, rows: Int[np.ndarray, " k"]) -> Cameras:
        """Return the cameras of tries that have one."""
        return Cameras(self.drawn.lenses.take(rows), self.world_from_camera[rows])

    @property
    def is_framed(self) -> Bool[np.ndarray, " n"]:
        """Whether the pose is final."""
        return self.rule >= CameraRule.SIZE


@dataclass(frozen=True, eq=False, slots=True)
class Views:
    """n cameras and what each sees of one vehicle; values after a rejection are nan."""

    # world_from_camera, fov_x_deg: poses, and (n,) horizontal fields of view
    world_from_camera: Float[np.ndarray, "n 4 4"]
    fov_x_deg: Float[np.ndarray, " n"]
    boxes: Boxes  # n boxes; nan for a vehicle outside the frame, or behind the camera
    visible_fraction: Float[np.ndarray, " n"]  # shares; 0 for a vehicle outside the frame
    air_contrast: Float[np.ndarray, " n"]  # share of the vehicle's contrast after haze; see `weather.extinction`
    rejection: UInt8[np.ndarray, " n"]
    # following, sampled, followed: a `Following`, and boxes of photographs; see `likeness.TargetBoxes`
    following: UInt8[np.ndarray, " n"]
    sampled: Int[np.ndarray, " n"]
    followed: Int[np.ndarray, " n"]

    @property
    def accepted_rows(self) -> Int[np.ndarray, " k"]:
        """Rows that no check has rejected."""
        return np.flatnonzero(self.rejection == Rejection.NONE)


@dataclass(frozen=True, eq=False, slots=True)
class ExtraViews:
    """Views of p pairs of an image and an extra in it, ordered by image and then by instance."""

    image: Int[np.ndarray, " p"]  # image, instance: rows of the block's images and of its table
    instance: Int[np.ndarray, " p"]
    views: Views  # views of the p pairs
    pixels: Bool[np.ndarray, " p"]  # whether an extra that has a class covers the center of any pixel


def nan_views(n: int) -> Views:
    """Allocate n views of nan, without rejections."""
    return Views(
        np.full((n, 4, 4), np.nan),
        np.full(n, np.nan),
        nan_boxes(n),
        np.full(n, np.nan),
        np.full(n, np.nan),
        np.zeros(n, dtype=np.uint8),
        np.zeros(n, dtype=np.uint8),
        np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.int64),
    )


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """n positions on one scenery, with m images in all."""

    stage: PlanStage  # stage, draws: the plan's config, vehicles, and distractors, and its random numbers
    draws: RandomStreams
    site: Site
    # companions and distractors that may occur, by whether the position is of backgrounds
    extras: Mapping[bool, Sequence[Extras]]
    positions: Positions  # the n positions, ascending by number
    model: Int[np.ndarray, " n"]  # index in the fleet of the vehicle that the cameras are framed on
    movable: Bool[np.ndarray, " n"]  # whether another scenery may be tried if this one has no place
    likeness: Likeness | None = None  # the photographs that cameras follow
    given: Given | None = None  # the poses that users give of all images of the plan

    @property
    def config(self) -> Config:
        """The plan's config."""
        return self.stage.config

    @property
    def empty(self) -> Bool[np.ndarray, " n"]:
        """Whether a position's images leave out the vehicle that they are framed on."""
        return self.positions.background & self.stage.fleet.classed[self.model]

    @property
    def position_rows(self) -> Int[np.ndarray, " m"]:
        """The row of each image's position."""
        return group_and_rank(self.positions.shots)[0]

    @property
    def shot(self) -> Int[np.ndarray, " m"]:
        """Number of each image among those of its position."""
        return group_and_rank(self.positions.shots)[1]

    @property
    def image(self) -> Int[np.ndarray, " m"]:
        """Index of each image."""
        return self.positions.first_image[self.position_rows] + self.shot

    @property
    def light_image_indices(self) -> Int[np.ndarray, " m"]:
        """Index of the image whose light, weather, and lens each image shares: the first of its sequence, or itself."""
        given = self.given_poses(self.image)
        return np.where(given.in_sequence, given.first, self.image)

    def given_poses(self, image: Int[np.ndarray, " k"]) -> Given:
        """Return the given poses of the images with these indices."""
        return empty_given_poses(len(image)) if self.given is None else take(self.given, image)


class PlaceState(IntEnum):
    """Whether an instance has a place, or why it has none."""

    PENDING = 0  # not yet
    PLACED = 1
    LEFT_OUT = 2  # an extra without room at its target's place
    ABANDONED = 3  # its position has no place or no view


@dataclass(frozen=True, eq=False, slots=True)
class InstanceTable(Instances):
    """The k instances of a block's positions, by position, role, and number; their rows are the positions'."""

    role: Int[np.ndarray, " k"]  # role, rank_in_role: role of each instance, and its number among those of this role
    rank_in_role: Int[np.ndarray, " k"]
    settled: Settled  # resting poses, which share the array `world_from_vehicle`
    tries: Int[np.ndarray, " k"]  # places tried so far; an instance with a place has the last one
    state: UInt8[np.ndarray, " k"]  # a `PlaceState`

    @property
    def is_placed(self) -> Bool[np.ndarray, " k"]:
        """Whether each instance has a place."""
        return self.state == PlaceState.PLACED

    @property
    def is_extra(self) -> Bool[np.ndarray, " k"]:
        """Whether each instance is a companion or distractor."""
        return self.role != InstanceRole.TARGET


def sample_instances(block: Block) -> InstanceTable:
    """Draw targets, companions, and distractors of a block's positions; none has a place yet."""
    positions, fleet, draws = block.positions, block.stage.fleet, block.draws
    n = len(positions.number)
    turns = draws.uniform(Purpose.ARTICULATION, positions.number, 0, count=fleet.max_parts)
    zero, likeness = np.zeros(n, dtype=np.int64), block.likeness
    photographed, follows_photograph = zero, np.zeros(n, dtype=bool)  # companions in the photograph, and whether it counts
    if likeness is not None:
        sampled, follows_photograph = likeness.sample_boxes_with_follow_mask(
            draws, fleet, model=block.model, image=positions.first_image
        )
        photographed = likeness.companion_counts(sampled)
    columns = [(np.arange(n), zero, zero, block.model, turns)]
    for background, kinds in block.extras.items():
        rows = np.flatnonzero(positions.background == background)
        for kind in kinds if len(rows) else ():
            i, number, model, uniform = kind.sample_extra_columns(
                draws,
                positions.number[rows],
                wanted=photographed[rows],
                is_wanted=follows_photograph[rows] & (kind.role == InstanceRole.COMPANION),
            )
            turned = np.zeros((len(i), fleet.max_parts))
            turned[:, :MAX_EXTRA_TURNS] = uniform[:, : fleet.max_parts]
            columns.append((rows[i], np.full(len(i), kind.role), number, model, turned))
    row, role, number, model, turns = (np.concatenate(column) for column in zip(*columns, strict=True))
    order = np.lexsort((number, role, row))
    row, role, number, model = row[order], role[order], number[order], model[order]
    angles = (
        part_angles_from_uniform(fleet, model, turns[order]) if block.config.placement.articulate else np.zeros(turns.shape)
    )
    k, settled = len(row), empty_settled(len(row))
    center = articulated_bounds(fleet, model, angles).mean(axis=1)
    tries, state = np.zeros(k, dtype=np.int64), np.full(k, PlaceState.PENDING, dtype=np.uint8)
    poses = settled.world_from_vehicle
    return InstanceTable(fleet, row, model, poses, angles, center, role, number, settled, tries, state)
