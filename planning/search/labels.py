"""Labels of vehicles: full, ignored because too little is visible, or none."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from hulldown.planning.config.schema import Config
from hulldown.planning.row import Label, rounded
from hulldown.planning.search.views import Views

LONGEST_CUT = 0.8  # default share of a labeled box that the frame may cut off, unless targets may lose more


def labels_of(views: Views, pixels: Bool[np.ndarray, " n"], config: Config) -> list[Label]:
    """Return the labels of n companions and distractors, by `config.annotate`, or the limits of targets by default.

    `pixels` tells whether a vehicle has a class and covers the center of any pixel; without, it has no label.
    """
    given, camera = config.annotate, config.camera
    least_px, least_visible = given.min_box_px, given.min_visible_fraction
    most_cut = given.max_truncated_fraction
    if most_cut is None:
        most_cut = max(LONGEST_CUT, camera.truncated_fraction[1])
    full = rounded("bbox", views.bbox)[:, 2:].min(axis=1) >= (camera.min_box_px if least_px is None else least_px)
    full &= rounded("visible_fraction", views.visible_fraction) >= (
        camera.visible_fraction[0] if least_visible is None else least_visible
    )
    full &= rounded("truncated_fraction", views.truncated_fraction) <= most_cut
    full &= rounded("air_contrast", views.air_contrast) >= config.weather.min_contrast
    below: Label = "ignored" if config.annotate.below == "ignored" else "none"
    pairs = zip(pixels.tolist(), full.tolist(), strict=True)
    return [("full" if enough else below) if shown else "none" for shown, enough in pairs]
