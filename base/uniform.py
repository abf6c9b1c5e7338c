"""A protocol for sources of uniform random numbers."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class UniformNumbers(Protocol):
    """A NumPy Generator, or another source of uniform numbers, such as one stream per row."""

    def random(self, size: Any) -> Any:
        """Return numbers uniform in [0, 1)."""

    def uniform(self, low: float, high: float, size: Any) -> Any:
        """Return numbers uniform between two bounds."""
