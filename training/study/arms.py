"""The runs of a study and the draws of each arm, as pure functions of the config and the datasets.

Arms differ only in their draws. Model, budget, and test are the same for all runs.
"""

from __future__ import annotations

from collections.abc import Mapping
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
        Its share of the photographs; None for arms without photographs.
    seed
        Seed of draws, augmentation, weights, and the selection of photographs.
    base
        The arm that defines its draws.
    train
        Settings that differ from other arms'.
    """

    arm: str
    fraction: float | None
    seed: int
    base: Arm
    train: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its name, unique in a study."""
        share = "" if self.fraction is None else f"-{subset_name(self.fraction)}"
        return f"{self.arm}{share}-seed{self.seed}"

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the datasets that it draws from."""
        return SOURCES[self.base]


def study_runs(config: StudyConfig) -> list[StudyRun]:
    """All runs, seed by seed, so that a study stopped early has complete seeds."""
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
    """Number of draws of an arm's run, if the real arm has `budget`."""
    return 2 * budget if arm == "matched" else budget


def arm_draws(run: StudyRun, photographs: Int[np.ndarray, " k"], synthetic: int, budget: int) -> Draws:
    """The draws of a run; `Draws.source` is an index into ``run.sources``.

    Parameters
    ----------
    run
        The run.
    photographs
        (k,) indices of its photographs in the real dataset.
    synthetic
        Number of synthetic pictures.
    budget
        Draws of the real arm.

    Examples
    --------
    `matched` has every draw of `real`, and as many synthetic ones between them:

    >>> real = arm_draws(StudyRun("real", 0.5, 0, "real"), np.array([3, 8]), 5, 4)
    >>> matched = arm_draws(StudyRun("matched", 0.5, 0, "matched"), np.array([3, 8]), 5, 4)
    >>> matched.source.tolist(), bool((matched.image[::2] == real.image).all())
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
        case "matched" | "pretrain":
            real, made = (make_draws([n], budget, seed=seed) for n in (k, synthetic))
            both = Draws(np.repeat([0, 1], budget), np.append(real.image, made.image), np.append(real.seed, made.seed))
            of_each = np.arange(2 * budget).reshape(2, budget)
            half = budget // 2
            in_turn, one_after_another = of_each.T.ravel(), np.append(of_each[1, :half], of_each[0, half:])
            draws = both.take(in_turn if run.base == "matched" else one_after_another)
    of_real = draws.source == 0
    image = draws.image.copy()
    image[of_real] = photographs[image[of_real]]
    return Draws(draws.source, image, draws.seed)
