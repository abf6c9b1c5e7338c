"""Which vehicles are planned on which sceneries: what the config allows, less what trial positions rule out.

References
----------
Paper, section 2.1.8, for sceneries that are drawn at random. That a pair may be impossible is not in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Float

from geometry.errors import ConfigError
from planning.air import draw_air
from planning.budget import Budget
from planning.draws import Draws
from planning.group import Group, HopelessPosition, plan_group
from planning.row import LeftOut
from planning.schema import Config
from planning.stage import Model, PlanStage, Site

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


def make_pairs(config: Config, budget: Budget, stage: PlanStage, draws: Draws, *, strict: bool) -> Pairs:
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
    for v, name in enumerate(budget.vehicles):
        allowed = _allowed_weights(config, name, stage.sites)
        wanted = bool(budget.images[v])
        problem: ConfigError | None = None
        if not wanted and config.placement.vehicles_per_image[1] == 1:
            continue
        for s in np.flatnonzero(allowed).tolist():
            try:
                _try_pair(stage.sites[s], stage.models[name], config, draws)
            except ConfigError as error:
                if strict and wanted:
                    raise
                problem = problem or error
                left_out.append(LeftOut(vehicle=name, scenery=stage.sites[s].name, why=error.problem))
            else:
                weights[v, s] = allowed[s]
        if problem and wanted and not weights[v].any():
            raise problem
    listed = {entry.name: entry.weight for entry in config.assets.sceneries}
    for site in stage.sites:
        for model in stage.distractors.values():
            _refuse_too_large(site, model, config)
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


def _try_pair(site: Site, model: Model, config: Config, draws: Draws) -> None:
    """Find places for the pair's trial positions.

    Raises
    ------
    ConfigError
        If most of them find none.
    """
    _refuse_too_large(site, model, config)
    one = np.ones(1, dtype=np.int64)
    failed = False
    for trial in range(1 + MORE_TRIALS):
        number = _FIRST_TRIAL + trial * one
        try:
            trial_group = Group(
                site=site,
                model=model,
                guests=(),
                background=False,
                empty=False,
                position=number,
                shots=one,
                first_image=number,
            )
            air = draw_air(config.weather, draws=draws, image=number)
            plan_group(trial_group, config, draws, visibility_m=air.visibility_m)
        except HopelessPosition as error:
            if failed:
                raise ConfigError(error.problem, path=error.path, remedy=error.remedy) from None
            failed = True
        else:
            if not failed:
                return


def _refuse_too_large(site: Site, model: Model, config: Config) -> None:
    room = config.placement.margin * (site.bounds[1] - site.bounds[0])
    length = max(model.shape.size_xyz[:2])
    if length > min(room):
        raise ConfigError(
            f"vehicle {model.shape.name!r} is {length:.4g} m long; in {site.name!r} vehicles "
            f"are placed within {room[0]:.4g} x {room[1]:.4g} m",
            path=config.path,
            remedy="look at both with `hulldown inspect`, and set the scale or the file that is wrong",
        )
