"""The arms of a study: a new one is an entry at the end of `ARM_KINDS`, whose order is that of their colors.

Arms differ only in their draws. Model, budget, and test are the same for all runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from jaxtyping import Int

from hulldown.training.inputs.draws import Draws, make_draws


def _in_turn(sizes: Sequence[int], budget: int, *, seed: int) -> Draws:
    return _separate(sizes, budget, seed).take(np.arange(2 * budget).reshape(2, budget).T.ravel())


def _synthetic_first(sizes: Sequence[int], budget: int, *, seed: int) -> Draws:
    half = budget // 2
    return _separate(sizes, budget, seed).take(np.append(np.arange(budget, budget + half), np.arange(half, budget)))


def _separate(sizes: Sequence[int], budget: int, seed: int) -> Draws:
    """Return a whole budget of each of two sources, one after the other."""
    real, made = (make_draws([size], budget, seed=seed) for size in sizes)
    return Draws(np.repeat([0, 1], budget), np.append(real.image, made.image), np.append(real.seed, made.seed))


@dataclass(frozen=True, eq=False, slots=True)
class ArmKind:
    """What an arm draws from, and what it's compared with besides the real arm."""

    sources: tuple[str, ...] = ("real", "synthetic")
    # function from the sizes of the sources, the budget, and the seed to draws from the sources' pictures
    draws: Callable[..., Draws] = make_draws
    beyond_mixed: bool = False  # whether it's compared with the mixed arm too
    by_bins: bool = False  # whether its recall is compared with the real arm's in bins


ARM_KINDS: Mapping[str, ArmKind] = MappingProxyType(
    {
        "real": ArmKind(("real",)),
        "mixed": ArmKind(by_bins=True),
        "synthetic": ArmKind(("synthetic",)),
        "matched": ArmKind(draws=_in_turn, beyond_mixed=True),
        "balanced": ArmKind(draws=partial(make_draws, shares=(0.5, 0.5)), beyond_mixed=True, by_bins=True),
        "pretrain": ArmKind(draws=_synthetic_first, beyond_mixed=True),
    }
)
if TYPE_CHECKING:
    Arm: TypeAlias = str
else:
    Arm = Literal[tuple(ARM_KINDS)]


def arm_draws(arm: Arm, photographs: Int[np.ndarray, " k"], synthetic: int, *, budget: int, seed: int) -> Draws:
    """Return the draws of a run of an arm; `Draws.source` is an index into its `ArmKind.sources`.

    Examples
    --------
    `matched` has every draw of `real`, and as many synthetic ones between them:

    >>> real, matched = (
    ...     arm_draws(arm, np.array([3, 8]), 5, budget=4, seed=0) for arm in ("real", "matched")
    ... )
    >>> matched.source.tolist(), bool((matched.image[::2] == real.image).all())
    ([0, 1, 0, 1, 0, 1, 0, 1], True)
    """
    kind = ARM_KINDS[arm]
    pictures = [photographs if name == "real" else np.arange(synthetic) for name in kind.sources]
    sizes = list(map(len, pictures))
    draws = kind.draws(sizes, budget, seed=seed)
    first = np.cumsum([0, *sizes])[draws.source]
    return Draws(draws.source, np.concatenate(pictures)[first + draws.image], draws.seed)
