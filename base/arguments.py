"""Types of arguments of functions that are commands: names of options, and the values that they take."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from cyclopts import Parameter


def make_option_check(expected: str, fits: Callable[[Any], bool]) -> Parameter:
    """Return a check of an option's values."""

    def check(_: object, value: Any) -> None:
        if value is not None and not fits(value):
            raise ValueError(f"Expected {expected}.")

    return Parameter(validator=check)


def make_option_parser(expected: str, parse: Callable[[str], Any], *, metavar: str) -> Parameter:
    """Return a parser of an option's text; `parse` raises ValueError for text that isn't as expected."""

    def convert(_: object, tokens: Any) -> Any:
        try:
            (text,) = (token.value for token in tokens)
            return parse(text)
        except ValueError:
            given = " ".join(token.value for token in tokens)
            raise ValueError(f"expected {expected}, got {given!r}") from None

    return Parameter(converter=convert, n_tokens=1, accepts_keys=False, metavar=metavar)


def make_suffix_check(suffix: str) -> Parameter:
    """Return a check of a file's name."""
    return make_option_check(f"the name of a {suffix} file", lambda path: Path(path).suffix.lower() == suffix)


PATH_PARSER = make_option_parser("a path", Path, metavar="PATH")
AnyPath: TypeAlias = Annotated[str | os.PathLike[str], PATH_PARSER]
PngFile: TypeAlias = Annotated[AnyPath, make_suffix_check(".png")]
BlendFile: TypeAlias = Annotated[AnyPath, make_suffix_check(".blend")]
HtmlFile: TypeAlias = Annotated[AnyPath, make_suffix_check(".html")]
Count: TypeAlias = Annotated[int, make_option_check("a whole number of at least 1", lambda number: number >= 1)]
Positive: TypeAlias = Annotated[float, make_option_check("a number above 0", lambda number: 0.0 < number < math.inf)]
FROM_ZERO = make_option_check("a number from 0 on", lambda number: 0.0 <= number < math.inf)
AtLeastZero: TypeAlias = Annotated[float, FROM_ZERO]
Overlap: TypeAlias = Annotated[float, make_option_check("a number above 0 and up to 1", lambda number: 0.0 < number <= 1.0)]
Share: TypeAlias = Annotated[float, make_option_check("a number from 0 to 1", lambda number: 0.0 <= number <= 1.0)]
