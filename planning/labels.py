"""What an image says of each vehicle in it: a full label, one to be ignored since it shows too little, or nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from annotate.masks import show_pixels
from camera.intrinsics import Lenses
from planning.instances import Instances
from planning.row import Label, rounded
from planning.schema import Config
from planning.stage import Site

LONGEST_CUT = 0.8  # of a label's box that the frame cuts off, unless targets may lose more


@dataclass(frozen=True, slots=True)
class Floors:
    """What a full label shows at least.

    Parameters
    ----------
    box_px
        The smaller side of its box, pixels.
    visible
        Its least visible fraction.
    truncated
        Its largest truncated fraction.
    air_contrast
        Least share of its contrast that the air leaves.
    """

    box_px: float
    visible: float
    truncated: float
    air_contrast: float


def floors(config: Config) -> Floors:
    """Those of a config; what it does not say is as for targets."""
    said, camera = config.annotate, config.camera
    return Floors(
        box_px=camera.min_box_px if said.min_box_px is None else said.min_box_px,
        visible=camera.visible_fraction[0] if said.min_visible_fraction is None else said.min_visible_fraction,
        truncated=max(LONGEST_CUT, camera.truncated_fraction[1])
        if said.max_truncated_fraction is None
        else said.max_truncated_fraction,
        air_contrast=config.weather.min_contrast,
    )


def labels_of(
    config: Config,
    *,
    bbox: Float[np.ndarray, "n 4"],
    visible: Float[np.ndarray, " n"],
    truncated: Float[np.ndarray, " n"],
    contrast: Float[np.ndarray, " n"],
    pixels: Bool[np.ndarray, " n"],
) -> list[Label]:
    """The labels of a vehicle that has a class but is no target, in n images.

    Parameters
    ----------
    config
        Whose floors hold.
    bbox, visible, truncated
        What the images' cameras see of it; nan out of the frame.
    contrast
        What the air leaves of its contrast.
    pixels
        Whether it is at the centre of any pixel.
    """
    least = floors(config)
    sides = rounded("bbox", bbox)[:, 2:].min(axis=1)
    full = (sides >= least.box_px) & (rounded("visible_fraction", visible) >= least.visible)
    full &= rounded("truncated_fraction", truncated) <= least.truncated
    full &= rounded("air_contrast", contrast) >= least.air_contrast
    below: Label = "ignored" if config.annotate.below == "ignored" else "none"
    shown = zip(pixels.tolist(), full.tolist(), strict=True)
    return [("full" if enough else below) if some else "none" for some, enough in shown]


def pixels_shown(
    site: Site,
    subjects: Instances,
    others: Instances,
    *,
    world_from_camera: Float[np.ndarray, "n 4 4"],
    lens: Lenses,
    bbox: Float[np.ndarray, "n 4"],
) -> Bool[np.ndarray, " n"]:
    """Whether the subject of each camera is at the centre of any pixel of its image: whether its mask has any."""
    shown = np.zeros(len(bbox), dtype=bool)
    rows = np.flatnonzero(~np.isnan(bbox[:, 0]))
    world = site.world.with_vehicles(others.beside(rows)[0].posed())
    subject = subjects.take(rows).in_own_rows().posed()
    shown[rows] = show_pixels(subject, world_from_camera[rows], lens.rows(rows), xywh=bbox[rows], world=world)
    return shown
