"""What all sections of a config share, and the ranges in them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

Pair = tuple[float, float]
Patterns = Annotated[tuple[str, ...], Field(strict=False)]
AtLeastZero = Annotated[float, Field(ge=0)]


class Section(BaseModel):
    """What all sections share: no unknown keys, no silent conversions, nothing changes afterwards."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def ranged(lowest: float, highest: float, kind: type = float, *, optional: bool = False) -> BeforeValidator:
    """Checks [low, high]; a single number is a range of one value, and None is none where that is `optional`."""
    noun = "a whole number" if kind is int else "a number"
    allowed = f"expected {noun} or [low, high] with {lowest:g} <= low <= high <= {highest:g}"

    def check(value: Any) -> tuple[Any, Any] | None:
        if optional and value is None:
            return None
        pair = tuple(value) if isinstance(value, (list, tuple)) else (value, value)
        wanted = int if kind is int else (int, float)
        if len(pair) != 2 or any(isinstance(x, bool) or not isinstance(x, wanted) for x in pair):
            raise ValueError(allowed)
        # NaN fails the comparison too.
        if not lowest <= pair[0] <= pair[1] <= highest:
            raise ValueError(allowed)
        return kind(pair[0]), kind(pair[1])

    check.bounds = lowest, highest  # type: ignore[attr-defined]  # for the docs
    return BeforeValidator(check)


def is_absent(value: Any) -> bool:
    """Whether a key isn't given: plans made before it existed don't have it either."""
    return value is None or value == (0.0, 0.0)


def are_numbers(values: Sequence[Any]) -> bool:
    """Whether all are finite numbers, and none is true or false."""
    # NaN fails the comparison, and so do integers that are no float.
    return all(isinstance(x, (int, float)) and not isinstance(x, bool) and abs(x) <= sys.float_info.max for x in values)
