"""Pairs of vehicles and sceneries that the config allows, without those whose trial positions fail."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Float, Int

from hulldown.base.errors import ConfigError
from hulldown.plan.config.schema import Config
from hulldown.plan.row import LeftOut
from hulldown.planning.search.budget import Budget, Positions
from hulldown.planning.search.positions import HopelessPosition, plan_block
from hulldown.planning.search.random_streams import RandomStreams
from hulldown.planning.search.stage import FleetModel, PlanStage, Site
from hulldown.planning.search.tables import Block

# A pair whose first trial fails needs both further trials to succeed: where few positions have a place, each of the
# others costs all tries. The numbers of trial positions are beyond those of any plan.
MORE_TRIALS = 2
_FIRST_TRIAL = 2**40


@dataclass(frozen=True, eq=False, slots=True)
class Pairs:
    """The weights of sceneries for each vehicle and for backgrounds."""

    # weight of each scenery for each vehicle of the budget; 0 for a pair that isn't planned
    weights: Float[np.ndarray, "v s"]
    sites: Float[np.ndarray, " s"]  # weight of each scenery for backgrounds
    left_out: tuple[LeftOut, ...]  # allowed pairs whose trials failed


def try_vehicle_scenery_pairs(stage: PlanStage, budget: Budget, draws: RandomStreams, *, strict: bool) -> Pairs:
    """Try every pair of vehicle and scenery that the config allows, and weight those that work."""
    config, weights, left_out = stage.config, np.zeros((len(budget.vehicles), len(stage.sites))), []
    listed = {entry.name: entry.weight for entry in config.assets.sceneries}
    of_sites = {site.name: listed.get(site.name, 1.0) for site in stage.sites}
    wanted = budget.images > 0
    planned = np.flatnonzero(wanted | (config.placement.vehicles_per_image[1] > 1))
    allowed = {v: _allowed_scenery_weights(config, budget.vehicles[v], of_sites) for v in planned.tolist()}
    problems: dict[tuple[int, int], ConfigError] = {}
    for s, site in enumerate(stage.sites):
        here = [v for v in planned.tolist() if allowed[v][s] > 0.0]
        models = np.array([stage.fleet.index[budget.vehicles[v]] for v in here], dtype=np.int64)
        for v, problem in zip(here, _trial_problems(site, stage, models, draws), strict=True):
            if problem:
                problems[v, s] = problem
            else:
                weights[v, s] = allowed[v][s]
    for (v, s), problem in sorted(problems.items()):
        if strict and wanted[v]:
            raise problem
        left_out.append(LeftOut(vehicle=budget.vehicles[v], scenery=stage.sites[s].name, why=problem.problem))
    for v in planned.tolist():
        if wanted[v] and not weights[v].any():
            raise next(problem for (vehicle, _), problem in sorted(problems.items()) if vehicle == v)
    for site in stage.sites:
        for model in stage.fleet.models[stage.vehicle_count :]:
            if problem := _too_large_error(site, model, config):
                raise problem
    return Pairs(weights, np.array(list(of_sites.values())), tuple(left_out))


def _allowed_scenery_weights(config: Config, vehicle: str, of_sites: Mapping[str, float]) -> Float[np.ndarray, " s"]:
    names = list(of_sites)
    entry = next((entry for entry in config.assets.vehicles if entry.name == vehicle), None)
    weights = np.array([weight if entry is None or entry.allows_scenery(name) else 0.0 for name, weight in of_sites.items()])
    for pattern in entry.sceneries if entry else ():
        if not any(fnmatchcase(name, pattern) for name in names):
            raise ConfigError(
                f"assets.vehicles: sceneries of {vehicle!r}: {pattern!r} matches no scenery",
                path=config.path,
                remedy=f"sceneries are {', '.join(names[:8])}{', ...' if len(names) > 8 else ''}",
            )
    if not weights.any():
        raise ConfigError(
            f"assets.vehicles: {vehicle!r} has no scenery: those that it is for have weight 0",
            path=config.path,
            remedy="give one a weight above 0, or change the vehicle's `sceneries`",
        )
    return weights


def _trial_problems(
    site: Site, stage: PlanStage, models: Int[np.ndarray, " v"], draws: RandomStreams
) -> list[ConfigError | None]:
    """Return for each of these vehicles why most of its trial positions fail; None if they don't."""
    problems: list[ConfigError | None] = [_too_large_error(site, stage.fleet.models[i], stage.config) for i in models.tolist()]
    fitting = np.array([i for i, problem in enumerate(problems) if problem is None], dtype=np.int64)
    failed = fitting[list(_failed_trial_errors(site, stage, models[fitting], draws, number=_FIRST_TRIAL))]
    for trial in range(1, 1 + MORE_TRIALS):
        tried = np.array([i for i in failed.tolist() if problems[i] is None], dtype=np.int64)
        for i, problem in _failed_trial_errors(site, stage, models[tried], draws, number=_FIRST_TRIAL + trial).items():
            problems[tried[i]] = problem
    return problems


def _failed_trial_errors(
    site: Site, stage: PlanStage, models: Int[np.ndarray, " n"], draws: RandomStreams, *, number: int
) -> Mapping[int, HopelessPosition]:
    """Plan a trial position for each of these vehicles; return the errors of those without a place."""
    n = len(models)
    if not n:
        return {}
    zero, one, trial = np.zeros(n, dtype=np.int64), np.ones(n, dtype=np.int64), np.full(n, number)
    positions = Positions(trial, vehicle=zero, ordinal=zero, shots=one, first_image=trial)
    return plan_block(Block(stage, draws, site, {}, positions, models, movable=one > 0)).problems


def _too_large_error(site: Site, model: FleetModel, config: Config) -> ConfigError | None:
    room = config.placement.margin * (site.bounds[1] - site.bounds[0])
    length = max(model.shape.size_xyz[:2])
    if length > min(room):
        return ConfigError(
            f"vehicle {model.shape.name!r} is {length:.4g} m long; in {site.name!r} vehicles "
            f"are placed within {room[0]:.4g} x {room[1]:.4g} m",
            path=config.path,
            remedy="look at both with `hulldown inspect`, and set the scale or the file that is wrong",
        )
    return None
