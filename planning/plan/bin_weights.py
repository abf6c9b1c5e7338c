"""Weights of labels, as a plan's header has them."""

from __future__ import annotations

from msgspec import Struct


class MoreOf(Struct, frozen=True, kw_only=True):
    """Weights of labels that a detector missed.

    Parameters
    ----------
    weights
        Weights by field and bin, with the names of an evaluation's report.
    picture_px
        Root of the area of the evaluated images, to which bins of box sizes refer.
    """

    weights: dict[str, dict[str, float]]
    picture_px: float
