"""Check that targets in rendered pictures are neither black, white, nor without contrast.

Thresholds were measured on 240 renders of the demo, 320 x 180 pixels at 5 samples, eight skies, fog in a seventh of
them; docs/dataset.md has the figures.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, UInt8

from hulldown.annotate.coco_types import Record
from hulldown.annotate.labels.mask import VisibleMask
from hulldown.annotate.masks import decode_mask
from hulldown.annotate.record_fields import PICTURE_KEY
from hulldown.annotate.records import Image
from hulldown.dataset.records import Finding
from hulldown.geometry.color import LUMINANCE

MIN_CONTRAST = 1.0  # of 255: a target with less, outside and within itself, isn't in the picture
CLEAR_CONTRAST = 8.0  # of 255: with less, it's hard to make out; sound renders had 20.9 and more
MIN_BRIGHTEST, MAX_DARKEST = 16.0, 250.0  # of 255: the brightest twentieth of a sound target had 34 and more
SURROUNDINGS_WIDTH = 0.25  # width of the surroundings, of a mask's longer side


@dataclass(frozen=True, slots=True)
class TargetAppearance:
    """A target's look in a picture; levels from 0 to 255."""

    # the difference of its mean color from its surroundings', in the channel where it's largest, or the range of its
    # own luminance, 10th to 90th percentile, if that is larger
    contrast: float
    darkest: float  # darkest, brightest: its luminance, 5th and 95th percentile
    brightest: float


def is_rendered(image: Record) -> bool:
    """Return whether an image record is of a rendered picture: photographs' records lack two keys."""
    return any(image.get(key) is not None for key in (PICTURE_KEY, "world_from_camera"))


def check_appearances(image: Image, pixels: UInt8[np.ndarray, "h w 3"]) -> Iterator[Finding]:
    """Find targets of a rendered picture that are black, white, or without contrast."""
    height, width = pixels.shape[:2]
    masked = []
    for label in image.labels:
        with contextlib.suppress(ValueError):  # found elsewhere
            masked.append((label, decode_mask(label.read(VisibleMask).segmentation, width, height)))
    covering = sum((mask for _, mask in masked), np.zeros((height, width), dtype=np.uint16))  # labels of each pixel
    for label, mask in masked:
        if not label.crowd and (seen := target_appearance(pixels, mask, covering > mask)) is not None:
            yield from _appearance_problems(f"{image.file_name}: annotation {label.id}", seen)


def _appearance_problems(where: str, seen: TargetAppearance) -> Iterator[Finding]:
    if seen.brightest < MIN_BRIGHTEST:
        yield Finding("error", where, f"its pixels are black: {seen.brightest:.1f} of 255", seen.brightest)
    elif seen.darkest > MAX_DARKEST:
        yield Finding("error", where, f"its pixels are white: {seen.darkest:.1f} of 255", seen.darkest)
    elif seen.contrast < MIN_CONTRAST:
        problem = f"cannot be seen in its picture: its contrast is {seen.contrast:.1f} of 255"
        yield Finding("error", where, problem, seen.contrast)
    elif seen.contrast < CLEAR_CONTRAST:
        problem = f"is hard to make out: its contrast is {seen.contrast:.1f} of 255"
        yield Finding("warning", where, problem, seen.contrast)


def target_appearance(
    picture: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"], others: Bool[np.ndarray, "h w"]
) -> TargetAppearance | None:
    """Measure the look of a target's pixels; None without any. Pixels of `others` don't count as surroundings."""
    if not mask.any():
        return None
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    margin = max(3, int(SURROUNDINGS_WIDTH * max(np.ptp(columns), np.ptp(rows))))
    near = tuple(slice(max(along[0] - margin, 0), along[-1] + margin + 1) for along in (rows, columns))
    colors, around = picture[near].astype(np.float32), ~(mask | others)[near]
    inside = colors[mask[near]]
    low, darkest, brightest, high = np.percentile(inside @ LUMINANCE, [10, 5, 95, 90]).tolist()
    apart = np.abs(inside.mean(axis=0) - colors[around].mean(axis=0)).max() if around.any() else 0.0
    return TargetAppearance(max(float(apart), high - low), darkest, brightest)
