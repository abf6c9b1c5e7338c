"""What stands in images besides targets: how many, of which models, how far; and what backgrounds are framed on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int

from hulldown.geometry.portable import sin_cos
from hulldown.planning.config.schema import Config
from hulldown.planning.search.budget import Budget, Positions
from hulldown.planning.search.draws import Purpose, RandomStreams, between, choose
from hulldown.planning.search.stage import PlanStage

MOST = 64  # of one kind in an image; a guest's number and a try's are told apart by it
_NUMBERS = 1 + MOST  # drawn for each guest: its model, its articulation


class Role(IntEnum):
    """What an instance is in its images, in the order in which they are placed."""

    TARGET = 0
    COMPANION = 1
    DISTRACTOR = 2


@dataclass(frozen=True, eq=False, slots=True)
class Extras:
    """Companions or distractors: one kind of what an image shows besides its target.

    Parameters
    ----------
    role
        Which.
    models, weights
        Indices in the fleet of what they are drawn from, and how often each.
    count
        Least and largest number in an image.
    distance
        Least and largest distance from the vehicle that the camera is framed on, meters.
    """

    role: Role
    models: Int[np.ndarray, " m"]
    weights: Float[np.ndarray, " m"]
    count: tuple[int, int]
    distance: tuple[float, float]

    def drawn(
        self, draws: RandomStreams, position: Int[np.ndarray, " n"], wanted: Int[np.ndarray, " n"]
    ) -> tuple[Int[np.ndarray, "n g"], Float[np.ndarray, "n g 64"]]:
        """For each position the model of each, -1 where there is none, and numbers to turn it by.

        As many as `wanted` within the limits; -1: any number.
        """
        low, high = self.count
        choice = Purpose.COMPANY if self.role == Role.COMPANION else Purpose.DISTRACTORS
        size = draws.uniform(choice, position, 0, count=1)[:, 0]
        number = low + np.minimum((size * (high - low + 1)).astype(np.int64), high - low)
        number = np.where(wanted >= 0, np.clip(wanted, low, high), number)
        model = np.full((len(position), high), -1)
        turns = np.zeros((len(position), high, MOST))
        for j in range(high):
            uniform = draws.uniform(choice, position, 1 + j, count=_NUMBERS)
            model[:, j] = np.where(number > j, self.models[choose(self.weights, uniform[:, 0])], -1)
            turns[:, j] = uniform[:, 1:]
        return model, turns


def offsets(
    role: Int[np.ndarray, " n"], distance: Float[np.ndarray, "n 2"], uniform: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """From targets to extras, meters in x and y, in proportion to numbers in [0, 1).

    Companions come close: all distances are alike. For distractors all places are alike, so that one beside a
    target is as likely as one on any other piece of ground of that size.
    """
    low, high = distance.T
    alike = between(low, high, uniform[:, 0])
    spread = np.clip(np.sqrt(between(low**2, high**2, uniform[:, 0])), low, high)
    away = np.where(role == Role.COMPANION, alike, spread)
    return away[:, None] * np.stack(sin_cos(2.0 * math.pi * uniform[:, 1])[::-1], axis=1)


def extras_at(site: str, stage: PlanStage, config: Config, *, background: bool) -> tuple[Extras, Extras]:
    """Companions and distractors of the positions on a site; those of backgrounds have no class.

    Parameters
    ----------
    site
        Its name.
    stage
        All models.
    config
        What is wanted.
    background
        Whether the positions are those of backgrounds.
    """
    limits = config.placement
    low, high = (0, 0) if background else (n - 1 for n in limits.vehicles_per_image)
    n = len(stage.models)
    companions = Extras(Role.COMPANION, np.arange(n), np.ones(n), (low, high), limits.companion_distance)
    models, weights = distractors_at(site, stage, config, unlabeled=background)
    count = limits.distractors_per_image if weights.any() else (0, 0)
    return companions, Extras(Role.DISTRACTOR, models, weights, count, limits.distractor_distance)


def distractors_at(
    site: str, stage: PlanStage, config: Config, *, unlabeled: bool
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """All distractors, and how often each is drawn on a site; `unlabeled`: never one that has a class."""
    weights = []
    for entry in config.assets.distractors:
        weights.append(entry.weight if entry.is_for(site) and not (unlabeled and entry.category) else 0.0)
    return len(stage.models) + np.arange(len(weights)), np.array(weights, dtype=np.float64)


def framed_on(
    budget: Budget,
    stage: PlanStage,
    config: Config,
    draws: RandomStreams,
    *,
    position: Int[np.ndarray, " n"],
    held: Positions,
    sites: list[str],
) -> list[str]:
    """The vehicle that the camera of each position is framed on.

    That is the budget's, and at a position of backgrounds one drawn as the budget gives them, which is left out of the
    picture; at the share `budget.background_distractors` of these, to the position, it is a distractor without a class.
    Where no such distractor occurs the picture stays empty.

    Parameters
    ----------
    budget, stage, config, draws
        Of the plan.
    position
        (n,) the positions' numbers.
    held
        What the budget says of them.
    sites
        n names of sceneries.
    """
    names = [budget.vehicles[v] for v in held.vehicle.tolist()]
    rows = np.flatnonzero(held.background)
    if not len(rows):
        return names
    uniform = draws.uniform(Purpose.BACKGROUND, position[rows], 0, count=2)
    like = np.minimum((uniform[:, 0] * budget.n_target_positions).astype(np.int64), budget.n_target_positions - 1)
    shown = budget.target_positions(like).vehicle
    share, before = config.budget.background_distractors, held.ordinal[rows]
    replaced = np.floor((before + 1) * share) > np.floor(before * share)
    for i, vehicle, distractor, u in zip(rows.tolist(), shown.tolist(), replaced.tolist(), uniform[:, 1], strict=True):
        models, weights = distractors_at(sites[i], stage, config, unlabeled=True)
        names[i] = budget.vehicles[vehicle]
        if distractor and weights.any():
            names[i] = stage.fleet.models[models[int(choose(weights, np.array([u]))[0])]].shape.name
    return names
