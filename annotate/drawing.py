"""Draw labels on pictures: boxes with class names, and what each type of labels draws."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw, ImageFont

from hulldown.annotate.coco_types import Record
from hulldown.annotate.label_list import LABEL_TYPES
from hulldown.annotate.label_type import Pen
from hulldown.annotate.record_fields import declared_fields

# Okabe and Ito, Color Universal Design, 2008: told apart by color-blind readers too. Black is left out.
CLASS_COLORS = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0), (204, 121, 167))
IGNORED_COLOR = (170, 170, 170)


def category_color(category_id: int) -> tuple[int, int, int]:
    """Return the color of a category, the same in every picture."""
    return CLASS_COLORS[(category_id - 1) % len(CLASS_COLORS)]


@cache
def label_font(size: int) -> ImageFont.FreeTypeFont:
    """Return DejaVu Sans, which comes with Matplotlib and has Cyrillic and Greek letters; `size` in pixels."""
    found = find_spec("matplotlib")  # importing it takes longer than drawing
    folder = Path(str(found and found.origin)).with_name("mpl-data")
    return ImageFont.truetype(folder / "fonts" / "ttf" / "DejaVuSans.ttf", size)


@dataclass(frozen=True, eq=False, slots=True)
class Overlay:
    """A label to draw over a picture."""

    bbox: Float[np.ndarray, "4"]  # x, y, width, and height in pixels
    category_id: int  # its class, which gives its color
    text: str  # what is written next to it
    ignored: bool = False  # whether training and evaluation ignore it: it's gray and has no text
    record: Record | None = None  # has the fields of other types of labels to draw

    @property
    def color(self) -> tuple[int, int, int]:
        """The color of its lines."""
        return IGNORED_COLOR if self.ignored else category_color(self.category_id)


def picture_with_labels(image: Image.Image, labels: Sequence[Overlay], *, tint: bool = True) -> Image.Image:
    """Return a copy of a picture with labels just outside their boxes, inside the picture, and with `tint` masks."""
    picture = image.convert("RGB")
    values = [[declared_fields(label.record, kind) for kind in LABEL_TYPES] if label.record else [] for label in labels]
    for label, of_label in zip(labels, values, strict=True):
        for each in of_label if tint else ():
            if (pixels := each.pixels_to_tint(*picture.size)) is not None:
                picture = _picture_with_tinted_mask(picture, pixels, label.color)
    canvas = ImageDraw.Draw(picture)
    line = max(1, round(picture.height / 360))
    font = label_font(max(10, picture.height // 36))
    for label, of_label in zip(labels, values, strict=True):
        x, y, w, h = label.bbox.tolist()
        first, last = (x, y), (x + w, y + h)  # pixels of a line around the box, those in the picture
        left, top = (min(max(math.floor(n) - line, 0), size - 1) for n, size in zip(first, picture.size, strict=True))
        right, bottom = (min(math.ceil(n) - 1 + line, size - 1) for n, size in zip(last, picture.size, strict=True))
        corners = left, top, max(left, right), max(top, bottom)
        canvas.rectangle(corners, outline=label.color, width=line)
        for each in of_label:
            each.draw_lines(Pen(canvas, label.color, line))
        if not label.ignored:
            _draw_name(canvas, corners, label.text, label.color, font, picture.size)
    return picture


def _draw_name(
    pen: ImageDraw.ImageDraw,
    corners: tuple[int, int, int, int],
    text: str,
    color: tuple[int, int, int],
    font: ImageFont.FreeTypeFont,
    size: tuple[int, int],
) -> None:
    left, top, right, bottom = pen.textbbox((0, 0), text, font=font)
    pad = max(2, int(bottom - top) // 5)
    width, height = int(right - left) + 2 * pad, int(bottom - top) + 2 * pad
    x = min(max(corners[0], 0), max(size[0] - width, 0))
    y = corners[1] - height + 1
    if y < 0:
        y = corners[3] if corners[3] + height <= size[1] else max(corners[1], 0)
    pen.rectangle((x, y, x + width - 1, y + height - 1), fill=color)
    dark = 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2] > 110
    pen.text((x + pad - left, y + pad - top), text, fill=(0, 0, 0) if dark else (255, 255, 255), font=font)


def _picture_with_tinted_mask(picture: Image.Image, mask: Bool[np.ndarray, "h w"], color: tuple[int, int, int]) -> Image.Image:
    pixels = np.asarray(picture).astype(np.float32)
    pixels[mask] = 0.6 * pixels[mask] + 0.4 * np.array(color, dtype=np.float32)
    return Image.fromarray(pixels.round().astype(np.uint8))
