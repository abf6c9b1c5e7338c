"""What a label must show at least: the floors of a config's `annotate`, held against a dataset that is finished."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from hulldown.dataset.store.seals import changed


@dataclass(frozen=True, slots=True)
class LabelFloors:
    """Floors of labels; what a label does not say, as those of photographs, is not held against it.

    Parameters
    ----------
    min_box_px
        Least width and height of its box.
    min_visible_fraction, max_truncated_fraction
        Least visible and largest truncated fraction.
    below
        What becomes of what shows less: ``"ignored"``: it gets ``iscrowd`` 1; ``"left_out"``: it goes.
    """

    min_box_px: float = 0.0
    min_visible_fraction: float = 0.0
    max_truncated_fraction: float = 1.0
    below: Literal["ignored", "left_out"] = "ignored"

    def kept(self, annotations: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        """The annotations that stay, in their order; those that are ignored already stay so, or go with the others."""
        kept: list[Mapping[str, Any]] = []
        for annotation in annotations:
            if self.enough(annotation) and not (annotation.get("iscrowd") and self.below == "left_out"):
                kept.append(annotation)
            elif self.below == "ignored":
                kept.append(changed(annotation, iscrowd=1))
        return kept

    def enough(self, annotation: Mapping[str, Any]) -> bool:
        """Whether an annotation shows what a full label must."""
        visible, truncated = (annotation.get(key) for key in ("visible_fraction", "truncated_fraction"))
        return (
            min(annotation["bbox"][2:]) >= self.min_box_px
            and (not isinstance(visible, int | float) or visible >= self.min_visible_fraction)
            and (not isinstance(truncated, int | float) or truncated <= self.max_truncated_fraction)
        )


ALL_LABELS = LabelFloors()
