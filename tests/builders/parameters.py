"""Parameters of which `make test` uses a part."""

from collections.abc import Iterable

import pytest


def few(cases: Iterable[str], *always: str) -> list:
    """Mark all cases as thorough, except those that always run."""
    return [case if case in always else pytest.param(case, marks=pytest.mark.thorough) for case in cases]
