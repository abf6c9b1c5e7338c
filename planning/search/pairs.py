"""Which vehicles are planned on which sceneries: what the config allows, less what trial positions rule out.

References
----------
Paper, section 2.1.8, for sceneries that are drawn at random. That a pair may be impossible is not in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Float, Int

from hulldown.geometry.errors import ConfigError
from hulldown.planning.appearance.air import draw_air
from hulldown.planning.config.schema import Config
from hulldown.planning.row import LeftOut
from hulldown.planning.search.block import Block, HopelessPosition
from hulldown.planning.search.budget import Budget
from hulldown.planning.search.draws import RandomStreams
from hulldown.planning.search.positions import plan_block
from hulldown.planning.search.stage import Fleet, Model, PlanStage, Site

# A pair whose first trial position finds no place is tried twice more, and both have to: where few positions find a
# place, each one without costs all tries. Their numbers are beyond those of any plan.
MORE_TRIALS = 2
_FIRST_TRIAL = 2**40


@dataclass(frozen=True, eq=False, slots=True)
class Pairs:
    """What each vehicle is planned on.

    Parameters
    ----------
    weights
        (v, s) how often each scenery is drawn for each vehicle of the budget; 0 for a pair that is not planned.
    sites
        (s,) how often each is drawn for backgrounds.
    left_out
        The pairs that the config allows and the trials rule out.
    """

    weights: Float[np.ndarray, "v s"]
    sites: Float[np.ndarray, " s"]
    left_out: tuple[LeftOut, ...]


def make_pairs(config: Config, budget: Budget, stage: PlanStage, draws: RandomStreams, *, strict: bool) -> Pairs:
    """Try every pair that the config allows.

    Parameters
    ----------
    config, budget, stage, draws
        The plan's.
    strict
        Whether a pair without a place is a mistake, and not left out.

    Raises
    ------
    ConfigError
        If a vehicle that has images has no scenery left.
    """
    weights, left_out = np.zeros((len(budget.vehicles), len(stage.sites))), []
    wanted = budget.images > 0
    planned = np.flatnonzero(wanted | (config.placement.vehicles_per_image[1] > 1))
    allowed = {v: _allowed_weights(config, budget.vehicles[v], stage.sites) for v in planned.tolist()}
    problems: dict[tuple[int, int], ConfigError] = {}
    for s, site in enumerate(stage.sites):
        here = [v for v in planned.tolist() if allowed[v][s] > 0.0]
        models = np.array([stage.fleet.index[budget.vehicles[v]] for v in here], dtype=np.int64)
        for v, problem in zip(here, _problems(site, stage.fleet, models, config, draws), strict=True):
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
            raise next(problem for (one, _), problem in sorted(problems.items()) if one == v)
    listed = {entry.name: entry.weight for entry in config.assets.sceneries}
    for site in stage.sites:
        for model in stage.distractors.values():
            if problem := _too_large(site, model, config):
                raise problem
    return Pairs(weights, np.array([listed.get(site.name, 1.0) for site in stage.sites]), tuple(left_out))


def _allowed_weights(config: Config, vehicle: str, sites: tuple[Site, ...]) -> Float[np.ndarray, " s"]:
    """The weights of the sceneries, 0 where the vehicle is not for them.

    Raises
    ------
    ConfigError
        If a pattern of the vehicle matches no scenery, or only such with weight 0.
    """
    names = [site.name for site in sites]
    listed = {entry.name: entry.weight for entry in config.assets.sceneries}
    entry = next((entry for entry in config.assets.vehicles if entry.name == vehicle), None)
    weights = np.array([listed.get(name, 1.0) if entry is None or entry.is_for(name) else 0.0 for name in names])
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


def _problems(
    site: Site, fleet: Fleet, models: Int[np.ndarray, " v"], config: Config, draws: RandomStreams
) -> list[ConfigError | None]:
    """For each of these vehicles why most of its trial positions on a site find no place, or None."""
    found: list[ConfigError | None] = [_too_large(site, fleet.models[i], config) for i in models.tolist()]
    fitting = np.array([i for i, problem in enumerate(found) if problem is None], dtype=np.int64)
    failed = fitting[list(_try(site, fleet, models[fitting], config, draws, number=_FIRST_TRIAL))]
    for trial in range(1, 1 + MORE_TRIALS):
        tried = np.array([i for i in failed.tolist() if found[i] is None], dtype=np.int64)
        for i, problem in _try(site, fleet, models[tried], config, draws, number=_FIRST_TRIAL + trial).items():
            found[tried[i]] = problem
    return found


def _try(
    site: Site, fleet: Fleet, models: Int[np.ndarray, " n"], config: Config, draws: RandomStreams, *, number: int
) -> dict[int, HopelessPosition]:
    """Which of these vehicles find no place at a trial position, and what was tried."""
    n = len(models)
    if not n:
        return {}
    trial = np.full(n, number)
    block = Block(
        site=site,
        fleet=fleet,
        extras={},
        model=models,
        background=np.zeros(n, dtype=bool),
        empty=np.zeros(n, dtype=bool),
        movable=np.ones(n, dtype=bool),
        position=trial,
        shots=np.ones(n, dtype=np.int64),
        first_image=trial,
    )
    air = draw_air(config.weather, draws=draws, image=trial)
    return plan_block(block, config, draws, visibility_m=air.visibility_m).problems


def _too_large(site: Site, model: Model, config: Config) -> ConfigError | None:
    """What is wrong with a vehicle that is longer than the area it is placed in."""
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
