"""Check that rendered pictures show their labels; photographs aren't checked."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import UInt8

from hulldown.annotate.masks import decode
from hulldown.dataset.records import Finding
from hulldown.dataset.store.seals import PICTURE_KEY
from hulldown.dataset.verification.look import BLACK, FAINT, NOTHING, UNLIKE, WHITE, Appearance, appearance

OURS = (PICTURE_KEY, "world_from_camera")  # keys that photographs' records lack


def is_rendered(image: Mapping[str, Any]) -> bool:
    """Whether an image record is of a rendered picture."""
    return any(image.get(key) is not None for key in OURS)


def check_looks(
    image: Mapping[str, Any], annotations: Sequence[Mapping[str, Any]], pixels: UInt8[np.ndarray, "h w 3"]
) -> Iterator[Finding]:
    """Find problems with the look of targets in a rendered picture.

    Parameters
    ----------
    image
        Its record, of the picture's size.
    annotations
        Its labels; those without a mask, and ignored ones, aren't checked.
    pixels
        The picture.
    """
    name, height, width = str(image.get("file_name")), *pixels.shape[:2]
    labels, masks = [], []
    for annotation in annotations:
        try:
            mask = decode(annotation["segmentation"], width, height)
        except (KeyError, ValueError):  # found elsewhere
            continue
        labels.append(annotation)
        masks.append(mask)
    looks: list[Appearance] = []
    covering = sum(masks, np.zeros((height, width), dtype=np.uint16))  # labels of each pixel
    for label, mask in zip(labels, masks, strict=True):
        if label.get("iscrowd"):
            continue
        if (look := appearance(pixels, mask, covering > mask)) is None:
            continue
        looks.append(look)
        yield from _label_problems(f"{name}: annotation {label['id']}", look)
    outlines = [look.outline for look in looks if look.contrast >= FAINT and not math.isnan(look.outline)]
    if outlines and (best := max(outlines)) < UNLIKE:
        problem = (
            f"does not show its labels: nothing changes along their outlines ({best:.2f}, expected {UNLIKE} or more)"
        )
        yield Finding("error", name, problem, best)


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
