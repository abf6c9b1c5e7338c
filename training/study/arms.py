"""The arms of a study: a new one is an entry at the end of `ARM_KINDS`, whose order is that of their colors.

Arms differ only in their draws. Model, budget, and test are the same for all runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from jaxtyping import Int

from hulldown.training.inputs.draws import Draws, make_draws


@dataclass(frozen=True, eq=False, slots=True)
class ArmKind:
    """What an arm draws from, and what it's compared with besides the real arm."""

    sources: tuple[str, ...] = ("real", "synthetic")
    shares: tuple[float, ...] = ()  # of the draws; empty: every picture is equally likely
    beyond_mixed: bool = False  # whether it's compared with the mixed arm too
    by_bins: bool = False  # whether its recall is compared with the real arm's in bins


ARM_KINDS: Mapping[str, ArmKind] = MappingProxyType(
    {
        "real": ArmKind(("real",)),
        "mixed": ArmKind(by_bins=True),
        "synthetic": ArmKind(("synthetic",)),
        "balanced": ArmKind(shares=(0.5, 0.5), beyond_mixed=True, by_bins=True),
    }
)
if TYPE_CHECKING:
    Arm: TypeAlias = str
else:
    Arm = Literal[tuple(ARM_KINDS)]


def arm_draws(arm: Arm, photographs: Int[np.ndarray, " k"], synthetic: int, *, budget: int, seed: int) -> Draws:
    """Return the draws of a run of an arm; `Draws.source` is an index into its `ArmKind.sources`."""
    kind = ARM_KINDS[arm]
    pictures = [photographs if name == "real" else np.arange(synthetic) for name in kind.sources]
    sizes = list(map(len, pictures))
    draws = make_draws(sizes, budget, seed=seed, shares=kind.shares)
    first = np.cumsum([0, *sizes])[draws.source]
    return Draws(draws.source, np.concatenate(pictures)[first + draws.image], draws.seed)
