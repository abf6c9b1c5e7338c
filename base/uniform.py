"""A protocol for sources of uniform random numbers, and a step whose multiples are spread evenly."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0  # multiples of it, modulo 1, are spread evenly


@runtime_checkable
class UniformNumbers(Protocol):
    """A NumPy Generator, or another source of uniform numbers, such as one stream per row."""

    def random(self, size: Any) -> Any:
        """Return numbers uniform in [0, 1)."""

    def uniform(self, low: float, high: float, size: Any) -> Any:
        """Return numbers uniform between two bounds."""
