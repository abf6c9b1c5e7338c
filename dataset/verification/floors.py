"""Limits of full labels, as in `[annotate]`, for finished datasets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from hulldown.dataset.store.seals import changed


@dataclass(frozen=True, slots=True)
class LabelFloors:
    """Limits of full labels; fields that a label lacks, such as a photograph's, are ignored.

    Parameters
    ----------
    min_box_px
        Least width and height of its box.
    min_visible_fraction, max_truncated_fraction
        Least visible and largest truncated fraction.
    below
        Labels that show less: ``"ignored"``: they get ``iscrowd`` 1; ``"left_out"``: they're dropped.
    """

    min_box_px: float = 0.0
    min_visible_fraction: float = 0.0
    max_truncated_fraction: float = 1.0
    below: Literal["ignored", "left_out"] = "ignored"

    def kept(self, annotations: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        """The kept annotations, in order; ignored ones stay ignored, or are dropped with the others."""
        kept: list[Mapping[str, Any]] = []
        for annotation in annotations:
            if self.enough(annotation) and not (annotation.get("iscrowd") and self.below == "left_out"):
                kept.append(annotation)
            elif self.below == "ignored":
                kept.append(changed(annotation, iscrowd=1))
        return kept

    def enough(self, annotation: Mapping[str, Any]) -> bool:
        """Whether an annotation is within the limits."""
        visible, truncated = (annotation.get(key) for key in ("visible_fraction", "truncated_fraction"))
        return (
            min(annotation["bbox"][2:]) >= self.min_box_px
            and (not isinstance(visible, int | float) or visible >= self.min_visible_fraction)
            and (not isinstance(truncated, int | float) or truncated <= self.max_truncated_fraction)
        )


ALL_LABELS = LabelFloors()
