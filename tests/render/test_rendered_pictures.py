import io

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from hulldown.render.process import picture_damage, png_without_notes


def encoded(notes):
    pixels = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    info = PngInfo()
    for key, value in notes.items():
        info.add_text(key, value)
        info.add_itxt(key + "_international", value)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG", pnginfo=info, exif=Image.Exif())
    return file.getvalue(), pixels


def test_notes_are_removed_and_pixels_kept():
    data, pixels = encoded({"Date": "2026/11/21", "File": "/home/somebody/field.blend"})
    plain = png_without_notes(data)
    assert b"somebody" in data
    assert b"somebody" not in plain
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(plain))), pixels)
    assert plain == png_without_notes(encoded({"Date": "another day"})[0])


def test_a_picture_without_notes_is_unchanged():
    data, _ = encoded({})
    assert png_without_notes(data) == data


def test_a_cut_file_and_one_of_another_format_are_refused():
    data, _ = encoded({})
    for cut in (1, 5, 20):
        with pytest.raises(ValueError, match="ends in the middle"):
            png_without_notes(data[:-cut])
    with pytest.raises(ValueError, match="expected a PNG file"):
        png_without_notes(b"GIF89a")


def test_a_picture_of_another_size_is_damage(tmp_path):
    path = tmp_path / "picture.png"
    Image.new("RGB", (6, 4)).save(path)
    assert picture_damage(path, 6, 4) is None
    assert picture_damage(path, 4, 6) is not None
    path.write_bytes(path.read_bytes()[:-20])
    assert picture_damage(path, 6, 4) is not None
