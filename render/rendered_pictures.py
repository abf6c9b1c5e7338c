"""Check a worker's pictures, and remove dates, render times, and paths from them."""

from __future__ import annotations

from pathlib import Path

from PIL.PngImagePlugin import PngImageFile

SIGNATURE = b"\x89PNG\r\n\x1a\n"
NOTES = (b"tEXt", b"zTXt", b"iTXt", b"eXIf", b"tIME")


def without_notes(data: bytes) -> bytes:
    """Remove text, date, and EXIF chunks (PNG, section 5), so that equal pictures are equal files."""
    if not data.startswith(SIGNATURE):
        raise ValueError("data: expected a PNG file, got something else")
    kept, at = [SIGNATURE], len(SIGNATURE)
    while at < len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4])
        if end > len(data):
            raise ValueError("data: expected a whole PNG file, got one that ends in the middle")
        if data[at + 4 : at + 8] not in NOTES:
            kept.append(data[at:end])
        at = end
    return b"".join(kept)


def picture_damage(picture: Path, width: int, height: int) -> str | None:
    """Find damage in a picture by Blender; None if there is none."""
    try:
        # Not by `Image.open`, which refuses pictures above a size.
        with PngImageFile(picture) as image:
            if image.size != (width, height):
                return f"Blender wrote a picture of {image.size}, expected {(width, height)}"
            image.verify()
    except (OSError, SyntaxError, ValueError) as error:
        return f"Blender wrote a picture that cannot be read ({error})"
    return None
