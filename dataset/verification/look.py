"""Check that rendered pictures show their labels, by a target's contrast and the strength of its outline.

Thresholds of color were measured on 240 renders of the demo, 320 x 180 pixels at 5 samples, eight skies, fog in a
seventh of them, those of outlines on 178 in all weathers, at three sizes; docs/dataset.md has the figures.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

from hulldown.annotate.masks import decode
from hulldown.assets.coco_types import Record
from hulldown.dataset.images import Image
from hulldown.dataset.labels.mask import MASK
from hulldown.dataset.records import Finding
from hulldown.dataset.store.seals import PICTURE_KEY
from hulldown.geometry.color import LUMINANCE

NOTHING = 1.0  # of 255: a target with less contrast, outside and within itself, isn't in the picture
FAINT = 8.0  # of 255: hard to make out; sound renders had 20.9 and more
BLACK, WHITE = 16.0, 250.0  # of 255: the brightest twentieth of a sound target had 34 and more
UNLIKE = 0.8  # outlines: see docs/dataset.md for what was measured
SHIFTS = (0.25, 0.5, 0.8, 1.2)  # of a mask's extent: how far its outline is moved to compare it
DIRECTIONS = 16  # in which it is moved
SECTORS = 12  # about a mask's center, in which steps across its outline are averaged
LEAST_SHARE, FEWEST = 0.3, 8  # a moved outline must be this far visible outside of the mask, and so many must be
SMALLEST = 30  # least pixels of a mask whose outline is measured
WIDEST = 640  # largest measured patch in pixels; larger ones are averaged down
AROUND = 0.25  # width of the surroundings, of a mask's longer side
_SOFT = 1.0  # pixels by which a mask is blurred for its outline's direction
_NOISE = 0.05  # of 255: gradients below are noise
_MIXED = np.array([[3, 1, 0], [1, 2, 1], [0, 1, 3]]) / 8


def is_rendered(image: Record) -> bool:
    """Return whether an image record is of a rendered picture: photographs' records lack two keys."""
    return any(image.get(key) is not None for key in (PICTURE_KEY, "world_from_camera"))


def check_looks(image: Image, pixels: UInt8[np.ndarray, "h w 3"]) -> Iterator[Finding]:
    """Find problems with the look of targets in a rendered picture."""
    height, width = pixels.shape[:2]
    masked = []
    for label in image.labels:
        with contextlib.suppress(ValueError):  # found elsewhere
            masked.append((label, decode(MASK.read(label).segmentation, width, height)))
    looks: list[Appearance] = []
    covering = sum((mask for _, mask in masked), np.zeros((height, width), dtype=np.uint16))  # labels of each pixel
    for label, mask in masked:
        if not label.crowd and (look := appearance(pixels, mask, covering > mask)) is not None:
            looks.append(look)
            yield from _label_problems(f"{image.file_name}: annotation {label.id}", look)
    outlines = [look.outline for look in looks if look.contrast >= FAINT and not math.isnan(look.outline)]
    if outlines and (best := max(outlines)) < UNLIKE:
        problem = (
            f"does not show its labels: nothing changes along their outlines ({best:.2f}, expected {UNLIKE} or more)"
        )
        yield Finding("error", image.file_name, problem, best)


def _label_problems(where: str, look: Appearance) -> Iterator[Finding]:
    if look.brightest < BLACK:
        yield Finding("error", where, f"its pixels are black: {look.brightest:.1f} of 255", look.brightest)
    elif look.darkest > WHITE:
        yield Finding("error", where, f"its pixels are white: {look.darkest:.1f} of 255", look.darkest)
    elif look.contrast < NOTHING:
        problem = f"cannot be seen in its picture: its contrast is {look.contrast:.1f} of 255"
        yield Finding("error", where, problem, look.contrast)
    elif look.contrast < FAINT:
        problem = f"is hard to make out: its contrast is {look.contrast:.1f} of 255"
        yield Finding("warning", where, problem, look.contrast)


@dataclass(frozen=True, slots=True)
class Appearance:
    """A target's look in a picture; levels from 0 to 255."""

    # its contrast: the difference of its mean color from its surroundings', in the channel where it's largest, or the
    # range of its own luminance, 10th to 90th percentile, if that is larger
    contrast: float
    darkest: float  # darkest, brightest: its luminance, 5th and 95th percentile
    brightest: float
    outline: float


def appearance(
    picture: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"], others: Bool[np.ndarray, "h w"]
) -> Appearance | None:
    """Measure a target's look; None if its mask is empty.

    `mask`: the target's pixels.
    `others`: pixels of other targets, which don't count as surroundings.
    """
    if not mask.any():
        return None
    near = _patch(mask, AROUND)
    colors, inside, around = _smaller(picture[near], mask[near], ~(mask | others)[near])
    if not inside.any():
        return None
    luminance = colors @ LUMINANCE
    low, darkest, brightest, high = np.percentile(luminance[inside], [10, 5, 95, 90])
    apart = np.abs(colors[inside].mean(axis=0) - colors[around].mean(axis=0)).max() if around.any() else 0.0
    wide = _patch(mask, SHIFTS[-1])
    return Appearance(
        contrast=float(max(apart, high - low)),
        darkest=float(darkest),
        brightest=float(brightest),
        outline=outline_strength(*_smaller(picture[wide], mask[wide], ~(mask | others)[wide])),
    )


def _patch(mask: Bool[np.ndarray, "h w"], margin: float, *, least: int = 3) -> tuple[slice, slice]:
    """Return rows and columns of a mask, with a margin in lengths of its longer side and at least a few pixels."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    pixels = max(least, int(margin * max(np.ptp(columns), np.ptp(rows))))
    return (
        slice(max(rows[0] - pixels, 0), rows[-1] + pixels + 1),
        slice(max(columns[0] - pixels, 0), columns[-1] + pixels + 1),
    )


def _smaller(
    picture: UInt8[np.ndarray, "h w 3"], inside: Bool[np.ndarray, "h w"], around: Bool[np.ndarray, "h w"]
) -> tuple[Float[np.ndarray, "m n 3"], Bool[np.ndarray, "m n"], Bool[np.ndarray, "m n"]]:
    """Average a picture down to at most `WIDEST` pixels, and the masks with it."""
    colors = picture.astype(np.float32)
    if (step := -(-max(inside.shape) // WIDEST)) == 1:
        return colors, inside, around
    smooth = ndimage.uniform_filter(colors, (step, step, 0))
    return smooth[::step, ::step], inside[::step, ::step], around[::step, ::step]


def outline_strength(
    colors: Float[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"], around: Bool[np.ndarray, "h w"]
) -> float:
    """Return how much steeper the picture is across a mask's outline than across moved copies of the outline.

    In standard deviations of the moved outlines, so about 0 for the outline of something else; nan if the mask or its
    surroundings are too small. Steepness is the gradient's component across the outline, averaged within sectors, in
    the color channel where it's largest. Moved outlines only count where they are outside of the mask.
    """
    if np.count_nonzero(mask) < SMALLEST:
        return np.nan
    near = _patch(mask, 0.0, least=8)  # beyond, the blurred mask is even
    soft = ndimage.gaussian_filter(mask[near].astype(np.float32), _SOFT)
    facing = np.stack([ndimage.sobel(soft, axis) for axis in (0, 1)])
    length = np.hypot(*facing)
    edge = length > 0.5 * length.max()
    y, x = np.nonzero(edge)
    y, x, facing = y + near[0].start, x + near[1].start, facing[:, edge] / length[edge]
    sector = (SECTORS * (np.arctan2(y - y.mean(), x - x.mean()) / (2.0 * np.pi) + 0.5)).astype(int) % SECTORS
    far, turn = np.meshgrid(SHIFTS, np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False), indexing="ij")
    moves = [np.maximum(4.0, far * np.ptp(y)) * np.sin(turn), np.maximum(4.0, far * np.ptp(x)) * np.cos(turn)]
    down, right = (np.append(0, move.round().astype(int)) for move in moves)  # the first copy isn't moved
    height, width = mask.shape
    rows, columns = y + down[:, None], x + right[:, None]
    at = rows * width + columns
    counts = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    free = around.copy()
    free[near] &= ~ndimage.binary_dilation(mask[near], iterations=2)
    counts[counts] = free.take(at[counts])
    counts[counts.sum(axis=1) < LEAST_SHARE * len(y)] = False
    counts[0] = True
    copy, point = np.nonzero(counts)
    at, group, facing = at[counts], copy * SECTORS + sector.take(point), facing.take(point, axis=1)
    sums = []
    for channel in np.moveaxis(colors, -1, 0):
        below, across = (part.take(at) for part in _gradient(channel))
        sums.append(np.bincount(group, below * facing[0] + across * facing[1], minlength=len(down) * SECTORS))
    strengths = _strengths(np.stack(sums), np.bincount(copy, minlength=len(down)))
    here, elsewhere = strengths[0], strengths[1:][counts[1:].any(axis=1)]
    if len(elsewhere) < FEWEST:
        return np.nan
    return float((here - np.median(elsewhere)) / (np.std(elsewhere) + _NOISE))


def _gradient(channel: Float[np.ndarray, "h w"]) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Return Sobel's gradient down and to the right, eight times as large."""
    around = np.pad(channel, 1, "edge")
    down, right = around[2:] - around[:-2], around[:, 2:] - around[:, :-2]
    return down[:, :-2] + 2 * down[:, 1:-1] + down[:, 2:], right[:-2] + 2 * right[1:-1] + right[2:]


def _strengths(
    sums: Float[np.ndarray, "3 copies*sectors"], points: Int[np.ndarray, " copies"]
) -> Float[np.ndarray, " copies"]:
    """Mean step across each copy of an outline; within a sector, steps up and down (noise, snow) cancel out."""
    largest = np.abs(_MIXED @ sums).max(axis=0).reshape(-1, SECTORS)
    return largest.sum(axis=1) / np.maximum(points, 1)
