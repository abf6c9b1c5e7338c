"""Draw boxes, masks, and class names on pictures, and make sheets of pictures."""

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

from hulldown.annotate.masks import decode

# Okabe and Ito, Color Universal Design, 2008: told apart by color-blind readers too. Black is left out.
PALETTE = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0), (204, 121, 167))
BACKGROUND = (24, 26, 30)
INK = (236, 236, 236)
IGNORED = (170, 170, 170)


def color_of(category_id: int) -> tuple[int, int, int]:
    """Return the color of a category, the same in every picture."""
    return PALETTE[(category_id - 1) % len(PALETTE)]


@cache
def lettering(size: int) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which comes with Matplotlib and has Cyrillic and Greek letters, too; `size` in pixels."""
    found = find_spec("matplotlib")  # importing it takes longer than drawing
    folder = Path(str(found and found.origin)).with_name("mpl-data")
    return ImageFont.truetype(folder / "fonts" / "ttf" / "DejaVuSans.ttf", size)


@dataclass(frozen=True, eq=False, slots=True)
class Overlay:
    """A box to draw over a picture, with its text, mask, and keypoints."""

    bbox: Float[np.ndarray, "4"]  # x, y, width, and height in pixels
    category_id: int  # its class, which gives its color
    text: str  # what is written next to it
    ignored: bool = False  # whether training and evaluation ignore it: it's gray and has no text
    segmentation: object = None  # COCO's; its mask is tinted
    keypoints: Sequence[float] = ()  # COCO's x, y, and v of each

    @property
    def color(self) -> tuple[int, int, int]:
        """The color of its lines."""
        return IGNORED if self.ignored else color_of(self.category_id)


def draw(image: Image.Image, boxes: Sequence[Overlay]) -> Image.Image:
    """Return a copy of a picture with boxes on it.

    Lines are drawn just outside the boxes, so that they hide nothing inside, but never outside the picture.
    """
    picture = image.convert("RGB")
    for box in boxes:
        if box.segmentation:
            picture = _tinted(picture, decode(box.segmentation, picture.width, picture.height), box.color)
    pen = ImageDraw.Draw(picture)
    line = max(1, round(picture.height / 360))
    font = lettering(max(10, picture.height // 36))
    for box in boxes:
        color = box.color
        x, y, w, h = box.bbox.tolist()
        first, last = (x, y), (x + w, y + h)  # pixels of a line around the box, those in the picture
        left, top = (min(max(math.floor(n) - line, 0), size - 1) for n, size in zip(first, picture.size, strict=True))
        right, bottom = (min(math.ceil(n) - 1 + line, size - 1) for n, size in zip(last, picture.size, strict=True))
        corners = left, top, max(left, right), max(top, bottom)
        pen.rectangle(corners, outline=color, width=line)
        for x, y, v in zip(box.keypoints[::3], box.keypoints[1::3], box.keypoints[2::3], strict=False):
            if v:
                around = (x - 2 * line, y - 2 * line, x + 2 * line, y + 2 * line)
                pen.ellipse(around, fill=color if v > 1 else None, outline=(0, 0, 0) if v > 1 else color, width=line)
        if not box.ignored:
            _label(pen, corners, box.text, color, font, picture.size)
    return picture


def contact_sheet(
    pictures: Sequence[Image.Image],
    *,
    columns: int = 4,
    tile_width: int = 480,
    captions: Sequence[str] | None = None,
) -> Image.Image:
    """Pictures side by side, row after row, each as wide as a tile.

    `columns`, `tile_width`: how many in a row, and how wide each is, in pixels.
    """
    if not pictures:
        raise ValueError("pictures: expected at least one, got none")
    if captions is not None and len(captions) != len(pictures):
        raise ValueError(f"captions: expected {len(pictures)}, one for each picture, got {len(captions)}")
    gap, letters = max(2, tile_width // 80), max(10, tile_width // 32)
    font = lettering(letters)
    lines = [_broken(caption, font, tile_width - 2 * gap) for caption in captions or ()]
    caption_height = max((2 * gap + round(1.2 * letters) * (caption.count("\n") + 1) for caption in lines), default=0)
    columns = min(columns, len(pictures))
    tiles = [
        picture.convert("RGB").resize(
            (tile_width, max(1, round(picture.height * tile_width / picture.width))), Image.Resampling.LANCZOS
        )
        for picture in pictures
    ]
    rows = [tiles[i : i + columns] for i in range(0, len(tiles), columns)]
    heights = [max(tile.height for tile in row) + caption_height for row in rows]
    sheet = Image.new("RGB", (columns * (tile_width + gap) + gap, sum(heights) + gap * (len(rows) + 1)), BACKGROUND)
    pen = ImageDraw.Draw(sheet)
    top = gap
    for r, (row, height) in enumerate(zip(rows, heights, strict=True)):
        for c, tile in enumerate(row):
            left = gap + c * (tile_width + gap)
            sheet.paste(tile, (left, top))
            if captions is not None:
                pen.text((left + gap, top + tile.height + gap // 2), lines[r * columns + c], fill=INK, font=font)
        top += height + gap
    return sheet


def _broken(text: str, font: ImageFont.FreeTypeFont, width: int) -> str:
    """Break a text into lines that are at most `width` pixels wide: between words, or inside one that's wider."""
    lines = [""]
    for word in (part for whole in text.split(" ") for part in _narrow(whole, font, width)):
        longer = f"{lines[-1]} {word}".strip()
        lines[-1:] = [longer] if not lines[-1] or font.getlength(longer) <= width else [lines[-1], word]
    return "\n".join(lines)


def _narrow(word: str, font: ImageFont.FreeTypeFont, width: int) -> list[str]:
    """Return a word in parts that are at most `width` pixels wide."""
    parts = [""]
    for letter in word:
        parts[-1:] = [parts[-1] + letter] if font.getlength(parts[-1] + letter) <= width else [parts[-1], letter]
    return parts


def _label(
    pen: ImageDraw.ImageDraw,
    corners: tuple[int, int, int, int],
    text: str,
    color: tuple[int, int, int],
    font: ImageFont.FreeTypeFont,
    size: tuple[int, int],
) -> None:
    """Write a class name above the box; below it, or inside, where there is no room."""
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


def _tinted(picture: Image.Image, mask: Bool[np.ndarray, "h w"], color: tuple[int, int, int]) -> Image.Image:
    pixels = np.asarray(picture).astype(np.float32)
    pixels[mask] = 0.6 * pixels[mask] + 0.4 * np.array(color, dtype=np.float32)
    return Image.fromarray(pixels.round().astype(np.uint8))
