"""Pictures of a dataset, read as they are: bytes and pixels, or what hinders it."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageFile, JpegImagePlugin, PngImagePlugin

from geometry.files import open_regular

LARGEST = 1 << 27  # pixels: four pictures are decoded at a time, 0.4 GB each


class UnreadableError(Exception):
    """A picture that is missing, damaged or no picture."""


@dataclass(frozen=True, eq=False, slots=True)
class PictureFile:
    """A picture's content.

    Parameters
    ----------
    content
        The file's bytes.
    size
        Its width and height in pixels.
    pixels
        (h, w, 3) bytes of colour; None for pictures of more than `LARGEST` pixels, whose size alone is known.
    """

    content: bytes
    size: tuple[int, int]
    pixels: UInt8[np.ndarray, "h w 3"] | None


def read_picture(path: Path) -> PictureFile:
    """Read and decode a picture.

    Raises
    ------
    UnreadableError
        Saying why.
    """
    try:
        with open_regular(path) as file:
            content = file.read()
        with _opened(content) as picture:
            size = picture.size
            if size[0] * size[1] > LARGEST:
                picture.verify()
                return PictureFile(content, size, None)
            return PictureFile(content, size, np.asarray(picture.convert("RGB")))
    except FileNotFoundError:
        raise UnreadableError("is missing") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        what = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise UnreadableError(f"cannot be decoded: {what}") from None


def open_picture(path: Path) -> ImageFile.ImageFile:
    """A picture of any size, to be decoded when it is asked for its pixels.

    Raises
    ------
    OSError, SyntaxError, ValueError
        If it cannot be read, is no regular file, or no picture.
    """
    with open_regular(path) as file:
        return _opened(file.read())


def _opened(content: bytes) -> ImageFile.ImageFile:
    """By the format's own class where it is known, since `Image.open` refuses pictures that are rendered all right."""
    file = io.BytesIO(content)
    if content.startswith(b"\x89PNG"):
        return PngImagePlugin.PngImageFile(file)
    if content.startswith(b"\xff\xd8\xff"):
        return JpegImagePlugin.JpegImageFile(file)
    return Image.open(file)
