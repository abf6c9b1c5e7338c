"""The base class of a config's sections, and checks that several sections use."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

Pair = tuple[float, float]
Share = Annotated[float, Field(ge=0, le=1)]
Patterns = Annotated[tuple[str, ...], Field(strict=False)]
AtLeastZero = Annotated[float, Field(ge=0)]


class Section(BaseModel):
    """A frozen model that refuses unknown keys and silent conversions; the string below a key is its meaning.

    pydantic reads these strings from the source, which an installation of .pyc files alone lacks.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


def range_validator(lowest: float, highest: float, kind: type = float, *, optional: bool = False) -> BeforeValidator:
    """Return a check of [low, high]; one number is a range of one value, and None is allowed if `optional`."""
    noun = "a whole number" if kind is int else "a number"
    allowed = f"expected {noun} or [low, high] with {lowest:g} <= low <= high <= {highest:g}"

    def check(value: object) -> tuple[float, float] | None:
        if optional and value is None:
            return None
        pair = tuple(value) if isinstance(value, (list, tuple)) else (value, value)
        kinds = int if kind is int else (int, float)
        numbers = len(pair) == 2 and not any(isinstance(x, bool) or not isinstance(x, kinds) for x in pair)
        if not numbers or not lowest <= pair[0] <= pair[1] <= highest:  # NaN fails the comparison, too
            raise ValueError(allowed)
        return kind(pair[0]), kind(pair[1])

    return BeforeValidator(check, json_schema_input_type=Annotated[kind, Field(ge=lowest, le=highest)])


Lengths = Annotated[Pair, range_validator(0.0, 1e6)]


def is_omitted_default(value: object) -> bool:
    """Return whether an optional key has its default, so that a plan's header leaves it out."""
    return value is None or value == (0.0, 0.0)
