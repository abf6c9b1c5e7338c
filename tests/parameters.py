"""Parameters that `make test` takes only some of."""

from collections.abc import Iterable

import pytest


def few(cases: Iterable[str], *always: str) -> list:
    """Return the cases, all but those that are always taken marked as thorough."""
    return [case if case in always else pytest.param(case, marks=pytest.mark.thorough) for case in cases]
