"""What a plan was made from, ready for the questions of its check."""

from __future__ import annotations

from dataclasses import dataclass

from assets.library import Assets
from planning.budget import Budget, make_budget
from planning.draws import Draws
from planning.light import hdri_weights
from planning.schema import Config
from planning.stage import PlanStage, make_stage


@dataclass(frozen=True, eq=False, slots=True)
class Source:
    """What a plan was made from, ready for questions.

    Parameters
    ----------
    config, assets
        The plan's.
    stage, budget, draws
        What planning makes of them.
    hdri_weights
        Name -> weight in most weather, and under the clouds of rain and snow.
    scenery_weights
        Name -> weight.
    """

    config: Config
    assets: Assets
    stage: PlanStage
    budget: Budget
    draws: Draws
    hdri_weights: dict[str, tuple[float, float]]
    scenery_weights: dict[str, float]

    @classmethod
    def of(cls, config: Config, assets: Assets) -> Source:
        """Build every hierarchy."""
        usual, cloudy = hdri_weights(config.light, assets.hdris).tolist()
        return cls(
            config=config,
            assets=assets,
            stage=make_stage(config, assets),
            budget=make_budget(config.budget, {name: assets.categories[name] for name in assets.vehicles}),
            draws=Draws(config.seed),
            hdri_weights=dict(zip(assets.hdris, zip(usual, cloudy, strict=True), strict=True)),
            scenery_weights={entry.name: entry.weight for entry in config.assets.sceneries},
        )
