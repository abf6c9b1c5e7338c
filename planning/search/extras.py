"""Companions and distractors: number, models, and distances; and the vehicles that backgrounds are framed on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int

from hulldown.geometry.portable import sin_cos
from hulldown.plan.config.scene_sections import PlacementSection
from hulldown.planning.search.budget import Budget, Positions
from hulldown.planning.search.random_streams import Purpose, RandomStreams, between, choose
from hulldown.planning.search.stage import PlanStage, Site

MOST_EXTRAS = 64  # extras of one role in an image; streams of random numbers are numbered by it
_NUMBERS = 1 + MOST_EXTRAS  # random numbers of each extra: its model, its articulation


class Role(IntEnum):
    """The role of an instance; roles are placed in this order."""

    TARGET = 0
    COMPANION = 1
    DISTRACTOR = 2


@dataclass(frozen=True, eq=False, slots=True)
class Extras:
    """The companions or distractors that may occur at a position."""

    role: Role
    models: Int[np.ndarray, " m"]  # models, weights: candidates as indices in the fleet, and their weights
    weights: Float[np.ndarray, " m"]
    count: tuple[int, int]  # least and largest number in an image

    def drawn(
        self, draws: RandomStreams, position: Int[np.ndarray, " n"], wanted: Int[np.ndarray, " n"]
    ) -> tuple[Int[np.ndarray, "n g"], Float[np.ndarray, "n g 64"]]:
        """Draw up to g extras for each position: their models, -1 for none, and uniform numbers for their angles.

        Their number is `wanted`, clipped to the limits; it is drawn where `wanted` is -1.
        """
        low, high = self.count
        choice = Purpose.COMPANY if self.role == Role.COMPANION else Purpose.DISTRACTORS
        size = draws.uniform(choice, position, 0, count=1)[:, 0]
        number = low + np.minimum((size * (high - low + 1)).astype(np.int64), high - low)
        number = np.where(wanted >= 0, np.clip(wanted, low, high), number)
        uniform = draws.uniform(choice, position[:, None], 1 + np.arange(high), count=_NUMBERS)
        model = self.models[choose(self.weights, uniform[..., 0])]
        return np.where(np.arange(high) < number[:, None], model, -1), uniform[..., 1:]


def offsets(
    role: Int[np.ndarray, " n"], limits: PlacementSection, uniform: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Return offsets from targets to extras, meters in x and y, in proportion to numbers in [0, 1).

    Companions are uniform in distance, distractors in area.
    """
    of_roles = np.array([(0.0, 0.0), limits.companion_distance, limits.distractor_distance])
    low, high = of_roles[role].T
    by_distance = between(low, high, uniform[:, 0])
    by_area = np.clip(np.sqrt(between(low**2, high**2, uniform[:, 0])), low, high)
    away = np.where(role == Role.COMPANION, by_distance, by_area)
    return away[:, None] * np.stack(sin_cos(2.0 * math.pi * uniform[:, 1])[::-1], axis=1)


def extras_at(site: Site, stage: PlanStage, of_vehicles: Float[np.ndarray, " v"]) -> dict[bool, list[Extras]]:
    """Return the companions and distractors of positions on a scenery, by whether these are backgrounds.

    `of_vehicles` are weights of companions. Backgrounds have neither companions nor distractors with a class.
    """
    limits, (least, most) = stage.config.placement, stage.config.placement.vehicles_per_image
    companions = Extras(Role.COMPANION, np.arange(stage.vehicles), of_vehicles, (least - 1, most - 1))
    extras: dict[bool, list[Extras]] = {False: [companions], True: []}
    for background, kinds in extras.items():
        models, weights = distractors_at(site, stage, unlabeled=background)
        if weights.any():
            kinds.append(Extras(Role.DISTRACTOR, models, weights, limits.distractors_per_image))
    return extras


def distractors_at(
    site: Site, stage: PlanStage, *, unlabeled: bool
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return all distractors and their weights on a scenery, 0 for those with a class if `unlabeled`."""
    weights = []
    for entry in stage.config.assets.distractors:
        weights.append(entry.weight if entry.is_for(site.name) and not (unlabeled and entry.category) else 0.0)
    return stage.vehicles + np.arange(len(weights)), np.array(weights, dtype=np.float64)


def framed_on(
    budget: Budget, stage: PlanStage, draws: RandomStreams, *, positions: Positions, site: Site
) -> Int[np.ndarray, " n"]:
    """Return the vehicle that the cameras of each position are framed on, as an index in the fleet.

    At a position of backgrounds, it's a vehicle drawn from the budget, which is left out of the picture. The share
    `budget.background_distractors` of these positions shows a distractor without a class instead, if the scenery has
    one.
    """
    index = np.array([stage.fleet.index[name] for name in budget.vehicles])
    model, rows = index[positions.vehicle], np.flatnonzero(positions.background)
    uniform = draws.uniform(Purpose.BACKGROUND, positions.number[rows], 0, count=2)
    planned = budget.positions.vehicle[~budget.positions.background]
    shown = np.minimum((uniform[:, 0] * len(planned)).astype(np.int64), len(planned) - 1)
    model[rows] = index[planned[shown]]
    share, ordinal = stage.config.budget.background_distractors, positions.ordinal[rows]
    replaced = np.floor((ordinal + 1) * share) > np.floor(ordinal * share)
    models, weights = distractors_at(site, stage, unlabeled=True)
    if weights.any():
        model[rows[replaced]] = models[choose(weights, uniform[replaced, 1])]
    return model
