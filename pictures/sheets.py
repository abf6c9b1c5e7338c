"""Sheets of pictures with captions."""

from __future__ import annotations

from collections.abc import Sequence

from PIL import Image, ImageDraw, ImageFont

from hulldown.annotate.drawing import label_font

BACKGROUND_COLOR = (24, 26, 30)
TEXT_COLOR = (236, 236, 236)


def contact_sheet(
    pictures: Sequence[Image.Image], *, columns: int = 4, tile_width: int = 480, captions: Sequence[str] | None = None
) -> Image.Image:
    """Return pictures side by side, `columns` in a row, each `tile_width` pixels wide."""
    if not pictures:
        raise ValueError("pictures: expected at least one, got none")
    if captions is not None and len(captions) != len(pictures):
        raise ValueError(f"captions: expected {len(pictures)}, one for each picture, got {len(captions)}")
    gap, letters = max(2, tile_width // 80), max(10, tile_width // 32)
    font = label_font(letters)
    lines = [_break_text(caption, font, tile_width - 2 * gap) for caption in captions or ()]
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
    sheet = Image.new("RGB", (columns * (tile_width + gap) + gap, sum(heights) + gap * (len(rows) + 1)), BACKGROUND_COLOR)
    pen = ImageDraw.Draw(sheet)
    top = gap
    for r, (row, height) in enumerate(zip(rows, heights, strict=True)):
        for c, tile in enumerate(row):
            left = gap + c * (tile_width + gap)
            sheet.paste(tile, (left, top))
            if captions is not None:
                pen.text((left + gap, top + tile.height + gap // 2), lines[r * columns + c], fill=TEXT_COLOR, font=font)
        top += height + gap
    return sheet


def _break_text(text: str, font: ImageFont.FreeTypeFont, width: int) -> str:
    """Break a text into lines at most `width` pixels wide: between words, or inside a word that's wider."""
    lines = [""]
    for word in (part for whole in text.split(" ") for part in _break_word(whole, font, width)):
        longer = f"{lines[-1]} {word}".strip()
        lines[-1:] = [longer] if not lines[-1] or font.getlength(longer) <= width else [lines[-1], word]
    return "\n".join(lines)


def _break_word(word: str, font: ImageFont.FreeTypeFont, width: int) -> list[str]:
    parts = [""]
    for letter in word:
        parts[-1:] = [parts[-1] + letter] if font.getlength(parts[-1] + letter) <= width else [parts[-1], letter]
    return parts
