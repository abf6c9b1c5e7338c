"""From a study to its runs: what each arm draws from what, pure functions of the config and the datasets.

An arm is nothing but a file of draws. All else is the same for every run: the model, the budget, the test.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Int

from hulldown.training.draws import Draws, make_draws
from hulldown.training.study.config import Arm, StudyConfig
from hulldown.training.subset import subset_name

SOURCES: dict[Arm, tuple[str, ...]] = {
    "real": ("real",),
    "mixed": ("real", "synthetic"),
    "synthetic": ("synthetic",),
    "matched": ("real", "synthetic"),
    "balanced": ("real", "synthetic"),
    "pretrain": ("real", "synthetic"),
    "loop": ("synthetic",),
}


@dataclass(frozen=True, slots=True)
class StudyRun:
    """One training of a study.

    Parameters
    ----------
    arm
        Its arm's name.
    fraction
        The share of the photographs that it may use; None of the arm that uses none.
    seed
        Of draws, augmentation, weights, and which photographs are the share.
    base
        The arm whose draws it has.
    train
        Keys of the settings that differ from those of other arms.
    """

    arm: str
    fraction: float | None
    seed: int
    base: Arm
    train: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Unique in a study."""
        share = "" if self.fraction is None else f"-{subset_name(self.fraction)}"
        return f"{self.arm}{share}-seed{self.seed}"

    @property
    def sources(self) -> tuple[str, ...]:
        """The datasets that it draws from."""
        return SOURCES[self.base]


def study_runs(config: StudyConfig) -> list[StudyRun]:
    """Every run, those of one seed after those of another, so that a study that is stopped early says something."""
    arms = config.settled_arms
    return [
        StudyRun(name, fraction, seed, base, train)
        for seed in config.seeds
        for (name, base, train), fraction in [
            *((arm, fraction) for fraction in config.fractions for arm in arms if "real" in SOURCES[arm[1]]),
            *((arm, None) for arm in arms if "real" not in SOURCES[arm[1]]),
        ]
    ]


def budget_of(arm: Arm, budget: int) -> int:
    """Draws of a run of an arm, where the real arm has `budget`."""
    return 2 * budget if arm == "matched" else budget


def arm_draws(run: StudyRun, photographs: Int[np.ndarray, " k"], synthetic: int, budget: int) -> Draws:
    """What a run is trained on, draw by draw; `Draws.source` is an index into ``run.sources``.

    Parameters
    ----------
    run
        Which.
    photographs
        (k,) the pictures of the real dataset that it may use.
    synthetic
        How many synthetic pictures there are.
    budget
        Draws of the real arm.

    Examples
    --------
    `matched` has every draw of `real`, and as many synthetic ones between them:

    >>> real = arm_draws(StudyRun("real", 0.5, 0, "real"), np.array([3, 8]), 5, 4)
    >>> matched = arm_draws(StudyRun("matched", 0.5, 0, "matched"), np.array([3, 8]), 5, 4)
    >>> matched.source.tolist(), (matched.image[::2] == real.image).all()
    ([0, 1, 0, 1, 0, 1, 0, 1], True)
    """
    k, seed = len(photographs), run.seed
    match run.base:
        case "real":
            draws = make_draws([k], budget, seed=seed)
        case "synthetic" | "loop":  # the loop's first detector
            return make_draws([synthetic], budget, seed=seed)
        case "mixed":
            draws = make_draws([k, synthetic], budget, seed=seed)
        case "balanced":
            draws = make_draws([k, synthetic], budget, seed=seed, shares=[0.5, 0.5])
        case "matched":
            both = [make_draws([n], budget, seed=seed) for n in (k, synthetic)]
            draws = _taken(both, np.tile([0, 1], budget), np.repeat(np.arange(budget), 2))
        case "pretrain":
            both = [make_draws([n], budget, seed=seed) for n in (k, synthetic)]
            draws = _taken(both, (np.arange(budget) < budget // 2).astype(np.int64), np.arange(budget))
    of_real = draws.source == 0
    image = draws.image.copy()
    image[of_real] = photographs[image[of_real]]
    return Draws(draws.source, image, draws.seed)


def _taken(both: Sequence[Draws], source: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]) -> Draws:
    """Row `row` of the draws from `source`, for each draw."""
    image, seed = (
        np.where(source == 0, getattr(both[0], key)[row], getattr(both[1], key)[row]) for key in ("image", "seed")
    )
    return Draws(source, image, seed)
