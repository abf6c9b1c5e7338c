"""Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1) -> str:
    """Return a table whose first `left` columns are aligned left and the others right.

    Examples
    --------
    >>> print(table(["rays", "us"], [["64", "122"], ["256", "339"]]))
    | rays | us |
    |---|---:|
    | 64 | 122 |
    | 256 | 339 |
    """
    ruler = "|" + "---|" * left + "---:|" * (len(head) - left)
    return "\n".join([_line(head), ruler, *map(_line, rows)])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
