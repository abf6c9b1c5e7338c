"""Write pictures for people, marked as ours, so that other files are never replaced."""

from __future__ import annotations

from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from hulldown.base.errors import HulldownError
from hulldown.base.files import atomic_writer, open_regular, prepare_output_file

SOFTWARE = {"Software": "hulldown"}  # the text by which a PNG file is known as ours
_MARK = b"tEXtSoftware\0hulldown"
_MARK_BYTES = 4096  # bytes before the pixels that contain the mark


def save_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture of ours, in one step."""
    refuse_foreign(path)
    notes = PngInfo()
    for key, text in SOFTWARE.items():
        notes.add_text(key, text)
    with atomic_writer(path) as file:
        picture.save(file, format="PNG", pnginfo=notes)


def refuse_foreign(path: Path, mark: bytes = _MARK) -> None:
    """Refuse to replace a file without our mark, by default a picture's; also called before the work."""
    try:
        with open_regular(path) as file:
            ours = mark in file.read(_MARK_BYTES)
    except FileNotFoundError:
        return
    except OSError:
        ours = False
    if not ours:
        raise HulldownError(
            "exists and wasn't drawn by hulldown", path=path, remedy="name another file by -o, or move it away"
        )


def make_room_for_picture(path: Path) -> None:
    """As `prepare_output_file`, and refuse to replace a file that isn't our picture."""
    prepare_output_file(path)
    refuse_foreign(path)
