"""What an image says of each vehicle in it: a full label, one to be ignored since it shows too little, or nothing."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from hulldown.planning.config.schema import Config
from hulldown.planning.row import Label, rounded
from hulldown.planning.search.aiming import Views

LONGEST_CUT = 0.8  # of a label's box that the frame cuts off, unless targets may lose more


def labels_of(views: Views, pixels: Bool[np.ndarray, " n"], config: Config) -> list[Label]:
    """Return the labels of vehicles that have a class but are no targets.

    Parameters
    ----------
    views
        What n cameras see of one vehicle each.
    pixels
        (n,) whether it is at the center of any pixel.
    config
        Whose `annotate` holds; what it leaves out is as for targets.
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
    shown = zip(pixels.tolist(), full.tolist(), strict=True)
    return [("full" if enough else below) if some else "none" for some, enough in shown]
