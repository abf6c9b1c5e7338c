"""The arms of a study: a new one is an entry at the end of `ARM_KINDS`, whose order is that of their colors.

Arms differ only in what they draw from. Model, budget, and test are the same for all runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, TypeAlias


@dataclass(frozen=True, eq=False, slots=True)
class ArmKind:
    """The data that an arm draws from, and the arms besides the real one that it's compared with."""

    sources: tuple[str, ...] = ("real", "synthetic")
    # of the draws; by default every picture is equally likely
    shares: Mapping[str, float] = field(default_factory=dict)
    beyond_mixed: bool = False  # whether it's compared with the mixed arm too


ARM_KINDS: Mapping[str, ArmKind] = MappingProxyType(
    {
        "real": ArmKind(("real",)),
        "mixed": ArmKind(),
        "synthetic": ArmKind(("synthetic",)),
        "balanced": ArmKind(shares={"real": 0.5, "synthetic": 0.5}, beyond_mixed=True),
    }
)
if TYPE_CHECKING:
    Arm: TypeAlias = str
else:
    Arm = Literal[tuple(ARM_KINDS)]
