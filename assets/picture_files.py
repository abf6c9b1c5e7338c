"""Read pictures of any mode and bit depth as 8-bit RGB, turned the way they are displayed."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageFile, ImageOps, JpegImagePlugin, PngImagePlugin, UnidentifiedImageError
from PIL.ExifTags import Base

from hulldown.base.errors import DatasetError
from hulldown.base.outside import MAX_DATA_BYTES, MISSING_FILE, read_file

DECODER_THREADS = 4
MAX_DECODED_PIXELS = 1 << 28  # decoding them takes 1.9 GB
# Of Pillow's formats, those of pictures that need no other program, as EPS does.
PICTURE_FORMATS = ("BMP", "GIF", "JPEG2000", "PPM", "TGA", "TIFF", "WEBP")
UPRIGHT_ORIENTATION = 1  # EXIF's value for a picture that is stored as it is displayed
_SIXTEEN, _THIRTY_TWO = 2.0**16 - 1.0, 2.0**32 - 1.0


@dataclass(frozen=True, eq=False, slots=True)
class PictureFile:
    """A picture and the bytes it was read from."""

    content: bytes
    size: tuple[int, int]  # width and height in pixels, as displayed
    orientation: int  # EXIF orientation, 1 to 8. From 5 on, stored width and height are swapped.
    pixels: UInt8[np.ndarray, "h w 3"] | None  # colors as displayed; None if it has more pixels than the caller's limit


def read_picture(path: Path, size: tuple[int, int] | None = None, *, largest: int | None = None) -> PictureFile:
    """Read a picture, of a stated width and height if given; of more than `largest` pixels, only structure and size."""
    picture = _read_picture_of_any_size(path, largest)
    if size is not None and picture.size != size:
        raise DatasetError(describe_size_difference(picture, size), path=path, remedy="correct the record or the picture")
    return picture


def _read_picture_of_any_size(path: Path, largest: int | None) -> PictureFile:
    def refuse(problem: object) -> DatasetError:
        if problem == MISSING_FILE:
            return DatasetError("is missing", path=path, remedy="put it there or delete its record")
        remedy = "render it again or replace it"
        return DatasetError(f"cannot be read as a picture ({problem})", path=path, remedy=remedy)

    content = read_file(path, refuse, most=MAX_DATA_BYTES)
    try:
        with _open_picture(content) as picture:
            width, height = picture.size
            if largest is not None and width * height > largest:
                # Looking for EXIF data after the pixels of a PNG would decode them.
                late = picture.format == "PNG" and "exif" not in picture.info
                orientation = UPRIGHT_ORIENTATION if late else _exif_orientation(picture)
                picture.verify()
                stored = orientation < 5 or picture.format == "TIFF"  # whose size Pillow has already turned
                size = (width, height) if stored else (height, width)
                return PictureFile(content, size, orientation, None)
            if width * height > MAX_DECODED_PIXELS:
                raise ValueError(f"it has {width} x {height} pixels, more than {MAX_DECODED_PIXELS:,} in all")
            orientation = _exif_orientation(picture)
            picture.load()
            ImageOps.exif_transpose(picture, in_place=True)
            return PictureFile(content, picture.size, orientation, rgb_pixels(picture))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise refuse(error.strerror if isinstance(error, OSError) and error.strerror else error) from None


def read_pixels(path: Path, size: tuple[int, int] | None = None) -> UInt8[np.ndarray, "h w 3"]:
    """Return a picture's colors as displayed, (h, w, 3); parameters and errors as for `read_picture`."""
    pixels = read_picture(path, size).pixels
    assert pixels is not None
    return pixels


def describe_size_difference(picture: PictureFile, stated: tuple[object, object]) -> str:
    """Describe how a picture's size differs from the size in its record."""
    turned = "" if picture.orientation == UPRIGHT_ORIENTATION else f" when displayed (EXIF orientation {picture.orientation})"
    width, height = picture.size
    return f"is {width} x {height} pixels{turned}, its record has {stated[0]} x {stated[1]}"


def rgb_pixels(picture: Image.Image) -> UInt8[np.ndarray, "h w 3"]:
    """Return a picture's colors as 8-bit RGB, integers scaled from their whole range, floats from 0 to 1."""
    mode = picture.mode
    if mode == "F":
        values = np.asarray(picture, dtype=np.float64)
        if not (np.isfinite(values).all() and values.min(initial=0.0) >= 0.0 and values.max(initial=0.0) <= 1.0):
            raise ValueError("its floating point values are not all from 0 to 1")
        return _gray_rgb_pixels(values)
    if mode == "I" and picture.format == "TIFF":
        if picture.getexif().get(Base.SampleFormat, (1,)) != (1,):
            raise ValueError("its integers are signed")
        return _gray_rgb_pixels(np.asarray(picture, dtype=np.int32).view(np.uint32) / _THIRTY_TWO)
    if mode == "I" or mode.startswith("I;16"):  # Pillow scales PGM, and before version 11 PNG, to 16 bits in "I"
        return _gray_rgb_pixels(np.asarray(picture).astype(np.float64) / _SIXTEEN)
    if mode in ("La", "RGBa"):  # colors multiplied by alpha
        picture = picture.convert(mode.replace("a", "A"))
    return np.asarray(picture.convert("RGB"))


def _gray_rgb_pixels(values: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    if values.max(initial=0.0) > 1.0 or values.min(initial=0.0) < 0.0:
        raise ValueError("its integers have more than 16 bits")
    return np.repeat(np.rint(values * 255.0).astype(np.uint8)[..., None], 3, axis=2)


def _exif_orientation(picture: Image.Image) -> int:
    orientation = picture.getexif().get(Base.Orientation, UPRIGHT_ORIENTATION)
    return orientation if isinstance(orientation, int) and 1 <= orientation <= 8 else UPRIGHT_ORIENTATION


def _open_picture(content: bytes) -> ImageFile.ImageFile:
    file = io.BytesIO(content)
    if content.startswith(b"\x89PNG"):
        return PngImagePlugin.PngImageFile(file)
    if content.startswith(b"\xff\xd8\xff"):
        return JpegImagePlugin.JpegImageFile(file)
    try:
        return Image.open(file, formats=PICTURE_FORMATS)
    except UnidentifiedImageError:
        raise ValueError("its format is unknown") from None
