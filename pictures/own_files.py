"""Write pictures for people, marked as ours, so that other files are never replaced."""

from __future__ import annotations

from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from hulldown.base.files import atomic_writer
from hulldown.base.outputs import require_replaceable_file

SOFTWARE_TEXT = {"Software": "hulldown"}  # marks a PNG file as ours
_SOFTWARE_CHUNK = b"tEXtSoftware\0hulldown"


def save_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture of ours, in one step."""
    require_replaceable_picture(path)
    notes = PngInfo()
    for key, text in SOFTWARE_TEXT.items():
        notes.add_text(key, text)
    with atomic_writer(path) as file:
        picture.save(file, format="PNG", pnginfo=notes)


def require_replaceable_picture(path: Path) -> None:
    """Create a picture's folder before long work; refuse to replace a picture that we didn't draw."""
    require_replaceable_file(path, "a picture", _SOFTWARE_CHUNK)
