"""What pictures look like, in figures: how a target stands out, and whether an outline is one in the picture too.

The thresholds were measured on 240 renders of the demo, 320 x 180 pixels at 5 samples, eight skies, fog in a seventh of
them; docs/dataset.md has the figures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy import ndimage

from geometry.color import LUMINANCE

NOTHING = 1.0  # of 255: a target that differs less from what is around it, and within itself, is not in the picture
FAINT = 8.0  # of 255: hard to make out; sound renders had 20.9 and more
BLACK, WHITE = 16.0, 250.0  # of 255: the brightest twentieth of a sound target had 34 and more
UNLIKE = 1.2  # outlines: of 240 sound pictures the lowest had 1.36
SMALLEST = 30  # pixels of a mask that has an outline to speak of
WIDEST = 640  # pixels of the patch that is looked at; larger ones are averaged down
AROUND = 0.25  # of a mask's longer side: how far around it its surroundings go
_SOFT = 1.0  # pixels by which a mask is blurred to tell which way its outline faces
_NOISE = 0.5  # of 255: gradients that say nothing


@dataclass(frozen=True, slots=True)
class Appearance:
    """How a target looks in a picture; all levels from 0 to 255.

    Parameters
    ----------
    contrast
        What tells it from its surroundings: the difference of the mean colours, in the channel where it is largest, or
        the range of its own luminance, 10th to 90th percentile, if that is larger.
    darkest, brightest
        Its luminance, 5th and 95th percentile.
    outline
        See `outline_strength`; nan for masks of fewer than `SMALLEST` pixels.
    """

    contrast: float
    darkest: float
    brightest: float
    outline: float


def appearance(
    picture: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"], others: Bool[np.ndarray, "h w"]
) -> Appearance | None:
    """How a target looks; None if its mask is empty.

    Parameters
    ----------
    picture
        The picture's colours.
    mask
        Where it shows the target.
    others
        Where it shows other targets, which are no surroundings.
    """
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not len(columns):
        return None
    margin = max(3, int(AROUND * max(np.ptp(columns), np.ptp(rows))))
    patch = (
        slice(max(rows[0] - margin, 0), rows[-1] + margin + 1),
        slice(max(columns[0] - margin, 0), columns[-1] + margin + 1),
    )
    colours, inside, around = picture[patch].astype(np.float32), mask[patch], ~(mask | others)[patch]
    if (step := -(-max(inside.shape) // WIDEST)) > 1:
        colours = ndimage.uniform_filter(colours, (step, step, 0))[::step, ::step]
        inside, around = inside[::step, ::step], around[::step, ::step]
    if not inside.any():
        return None
    luminance = colours @ LUMINANCE.astype(np.float32)
    low, darkest, brightest, high = np.percentile(luminance[inside], [10, 5, 95, 90])
    apart = np.abs(colours[inside].mean(axis=0) - colours[around].mean(axis=0)).max() if around.any() else 0.0
    return Appearance(
        contrast=float(max(apart, high - low)),
        darkest=float(darkest),
        brightest=float(brightest),
        outline=outline_strength(luminance, inside) if np.count_nonzero(inside) >= SMALLEST else np.nan,
    )


def outline_strength(luminance: Float[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"]) -> float:
    """How much steeper a picture is across a mask's outline than elsewhere; about 1 for an outline of something else.

    The mean of the gradient's component across the outline, over the mean that the gradients elsewhere would have in a
    direction of chance (2 / pi of their length). nan where a mask has no outline in the picture.
    """
    gradient = np.stack([ndimage.sobel(luminance, axis) for axis in (0, 1)]) / 8.0
    soft = ndimage.gaussian_filter(mask.astype(np.float32), _SOFT)
    facing = np.stack([ndimage.sobel(soft, axis) for axis in (0, 1)])
    length = np.hypot(*facing)
    if not length.max() > 0.0:
        return np.nan
    edge = length > 0.5 * length.max()
    if edge.all():
        return np.nan
    across = np.abs((gradient * facing).sum(axis=0)[edge] / length[edge]).mean()
    elsewhere = np.hypot(*gradient)[~edge].mean() * 2.0 / np.pi
    return float(across / (elsewhere + _NOISE))
