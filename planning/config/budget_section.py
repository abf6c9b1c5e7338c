"""The config's `[budget]`: numbers of images."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from hulldown.planning.config.section import Section, Share

MOST_IMAGES = 1_000_000_000  # of a class


def _per_class(value: object) -> object:
    """Check a number of images for every class, or a table of numbers by class."""
    counts = list(value.values()) if isinstance(value, dict) else [value]
    if value is not None and any(type(n) is not int or not 0 <= n <= MOST_IMAGES for n in counts):
        raise ValueError(f"expected a whole number from 0 to {MOST_IMAGES}, or a table of them by class")
    return value


PerClass = Annotated[int | dict[str, int] | None, BeforeValidator(_per_class)]


class BudgetSection(Section):
    """How many images: per class (paper, section 2.1.8), or by positions per vehicle (equation 1)."""

    images_per_class: PerClass = Field(default=None, examples=[140])
    """a number, or a table such as { tank = 200, truck = 100 }; a class's models take turns"""
    positions_per_vehicle: int | None = Field(default=None, ge=0, le=MOST_IMAGES, examples=[28])
    """instead: vehicles x positions x images_per_position images (equation 1)"""
    images_per_position: int = Field(default=5, ge=1, le=1_000_000)
    """images of each position"""
    background_share: float = Field(default=0.0, ge=0, le=0.99)
    """share of images without a target, added to those above"""
    background_distractors: Share = 0.5
    """share of background positions where a distractor replaces the target"""

    @model_validator(mode="after")
    def _one_of_two(self) -> BudgetSection:
        if (self.images_per_class is None) == (self.positions_per_vehicle is None):
            raise ValueError("expected exactly one of images_per_class and positions_per_vehicle")
        return self
