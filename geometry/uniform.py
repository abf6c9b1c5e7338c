"""Where random numbers come from, for functions that draw."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class UniformNumbers(Protocol):
    """A NumPy Generator, or anything else that hands out uniform numbers, such as one stream for each row."""

    def random(self, size: Any) -> Any:
        """Numbers uniform in [0, 1)."""

    def uniform(self, low: float, high: float, size: Any) -> Any:
        """Numbers uniform between two bounds."""
