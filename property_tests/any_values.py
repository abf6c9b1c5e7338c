"""Values that people may write into files, and the messages that they get."""

from collections.abc import Callable
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st

from hulldown.base.errors import HulldownError

# 20,000 inputs in the thorough profile.
MANY = settings(max_examples=settings.default.max_examples * (10 if settings.default.max_examples >= 2000 else 1))
ODD = (
    *(None, True, -1, 0, 1, 2, 2**31, 2**53, 1e308, -0.0, 0.5, [], {}, [[]], [1, 2, 3, 4], [1e308] * 4),
    *("", "x", "../x", "/x", "images/1.png", "images/./1.png", ".unfinished/1.png", "\x1b[31m", "\ud7ff", "a" * 9999),
)


def values_of(*more: Any) -> st.SearchStrategy[Any]:
    """Odd values, including these, and numbers and texts of any kind."""
    numbers = st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False)
    return st.sampled_from([*ODD, *more]) | numbers | st.text(max_size=5)


def containers(value: Any) -> list[Any]:
    """Every object and list in a JSON value, including itself."""
    inner = list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else []
    return [value] * isinstance(value, (dict, list)) + [found for each in inner for found in containers(each)]


def refusal(use: Callable[..., object], *arguments: object) -> str:
    """The user's message about a mistake in a file; any other error is a bug, and not caught."""
    try:
        use(*arguments)
    except HulldownError as error:
        return str(error)
    return ""
