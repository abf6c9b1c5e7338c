"""The runs of a study and the draws of each arm, as pure functions of the config and the datasets.

Arms differ only in their draws. Model, budget, and test are the same for all runs.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from hulldown.training.inputs.draws import Draws, make_draws
from hulldown.training.study.config import Arm, NamedArm, StudyConfig

SOURCES: dict[Arm, tuple[str, ...]] = {
    "real": ("real",),
    "mixed": ("real", "synthetic"),
    "synthetic": ("synthetic",),
    "matched": ("real", "synthetic"),
    "balanced": ("real", "synthetic"),
    "pretrain": ("real", "synthetic"),
}


def study_runs(config: StudyConfig) -> list[tuple[NamedArm, float | None, int]]:
    """Arm, share of the photographs, and seed of all runs, seed by seed, so that one stopped early has complete seeds.

    The share is None for arms without photographs.
    """
    arms = config.named_arms
    of_seed: list[tuple[NamedArm, float | None]] = [
        *((arm, fraction) for fraction in config.fractions for arm in arms if "real" in SOURCES[arm.base]),
        *((arm, None) for arm in arms if "real" not in SOURCES[arm.base]),
    ]
    return [(arm, fraction, seed) for seed in config.seeds for arm, fraction in of_seed]


def arm_draws(arm: Arm, photographs: Int[np.ndarray, " k"], synthetic: int, *, budget: int, seed: int) -> Draws:
    """Return the draws of a run of an arm; `Draws.source` is an index into its `SOURCES`.

    Parameters
    ----------
    arm
        The arm.
    photographs
        (k,) indices of its photographs in the real dataset.
    synthetic
        Number of synthetic pictures.
    budget
        Draws of the real arm; `matched` has twice as many.
    seed
        Seed of the draws.

    Examples
    --------
    `matched` has every draw of `real`, and as many synthetic ones between them:

    >>> real, matched = (
    ...     arm_draws(arm, np.array([3, 8]), 5, budget=4, seed=0) for arm in ("real", "matched")
    ... )
    >>> matched.source.tolist(), bool((matched.image[::2] == real.image).all())
    ([0, 1, 0, 1, 0, 1, 0, 1], True)
    """
    pictures = [photographs if name == "real" else np.arange(synthetic) for name in SOURCES[arm]]
    sizes = list(map(len, pictures))
    if arm in ("matched", "pretrain"):
        real, made = (make_draws([size], budget, seed=seed) for size in sizes)
        both = Draws(np.repeat([0, 1], budget), np.append(real.image, made.image), np.append(real.seed, made.seed))
        of_each, half = np.arange(2 * budget).reshape(2, budget), budget // 2
        in_turn, one_after_another = of_each.T.ravel(), np.append(of_each[1, :half], of_each[0, half:])
        draws = both.take(in_turn if arm == "matched" else one_after_another)
    else:
        draws = make_draws(sizes, budget, seed=seed, shares=[0.5, 0.5] if arm == "balanced" else ())
    first = np.cumsum([0, *sizes])[draws.source]
    return Draws(draws.source, np.concatenate(pictures)[first + draws.image], draws.seed)
