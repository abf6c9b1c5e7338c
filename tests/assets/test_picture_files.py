"""Pictures of every mode, bit depth, and orientation are read with the displayed colors."""

import numpy as np
import pytest
from PIL import Image

from hulldown.annotate.drawing import Overlay, picture_with_labels
from hulldown.assets.picture_files import read_picture, read_pixels, rgb_pixels
from hulldown.base.errors import DatasetError
from hulldown.dataset.table import Dataset
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import write_dataset
from hulldown.training.inputs.sources import read_classes_and_sources

GRAY = np.array([[0, 51, 102], [153, 204, 255]], dtype=np.uint8)  # fifths of the range, in every bit depth
COLOR = np.stack([GRAY, GRAY[::-1], np.full_like(GRAY, 128)], axis=2)
GRAY_AS_RGB = np.repeat(GRAY[..., None], 3, axis=2)


def of_mode(mode):
    """A picture of a mode, and its displayed colors."""
    if mode.startswith("I;16"):
        values = (GRAY / 255.0 * 65535.0).astype({"B": ">u2"}.get(mode[-1], "<u2"))
        return Image.frombytes(mode, (3, 2), values.tobytes()), GRAY_AS_RGB
    if mode in ("I", "F"):
        values = (GRAY / 255.0 * 65535.0).astype(np.int32) if mode == "I" else (GRAY / 255.0).astype(np.float32)
        return Image.fromarray(values), GRAY_AS_RGB
    if mode == "1":
        return Image.fromarray(GRAY > 127), 255 * np.uint8(GRAY_AS_RGB > 127)
    gray = mode in ("L", "LA", "La", "P", "PA")
    plain = {"La": "LA", "RGBa": "RGBA"}.get(mode, mode)  # colors are multiplied by alpha only from there
    return Image.fromarray(GRAY if gray else COLOR).convert(plain).convert(mode), GRAY_AS_RGB if gray else COLOR


MODES = ["1", "L", "LA", "La", "P", "PA", "RGB", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr", "HSV", "LAB", "F", "I",
         "I;16", "I;16L", "I;16B", "I;16N"]  # fmt: skip


@pytest.mark.parametrize("mode", MODES)
def test_every_mode_of_pillow_keeps_its_values(mode):
    picture, wanted = of_mode(mode)
    tolerance = {"YCbCr": 3, "HSV": 3, "LAB": 20}.get(mode, 0)  # no exact counterpart in these modes
    np.testing.assert_allclose(rgb_pixels(picture).astype(int), wanted.astype(int), rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("suffix", "values"),
    [
        (".png", (GRAY / 255.0 * 65535.0).astype(np.uint16)),
        (".tif", (GRAY / 255.0 * 65535.0).astype(np.uint16)),
        (".pgm", (GRAY / 255.0 * 65535.0).astype(np.uint16)),
        (".tif", (GRAY / 255.0).astype(np.float32)),
    ],
)
def test_files_are_scaled_by_their_bit_depth(tmp_path, suffix, values):
    path = tmp_path / f"a{suffix}"
    Image.fromarray(values).save(path)
    np.testing.assert_array_equal(read_pixels(path), GRAY_AS_RGB)


@pytest.mark.parametrize("values", [np.full((2, 2), 2.0), np.full((2, 2), np.nan), np.full((2, 2), -1)])
def test_values_of_unknown_range_are_refused(tmp_path, values):
    Image.fromarray(values.astype(np.float32 if values.dtype.kind == "f" else np.int32)).save(tmp_path / "a.tif")
    with pytest.raises(DatasetError, match="cannot be read as a picture"):
        read_pixels(tmp_path / "a.tif")


def save_turned(path, stored, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    lossless = {"quality": 100, "subsampling": 0} if path.suffix == ".jpg" else {}
    Image.fromarray(stored).save(path, exif=exif, **lossless)


# Effect of each orientation on the stored array (EXIF 2.3, section 4.6.4 A).
TURNS = {
    1: lambda a: a, 2: lambda a: a[:, ::-1], 3: lambda a: a[::-1, ::-1], 4: lambda a: a[::-1],
    5: lambda a: a.transpose(1, 0, 2), 6: lambda a: np.rot90(a, -1), 7: lambda a: a[::-1, ::-1].transpose(1, 0, 2),
    8: lambda a: np.rot90(a),
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied(tmp_path, suffix, orientation):
    path = tmp_path / f"a{suffix}"
    stored = np.kron(COLOR, np.ones((16, 16, 1), np.uint8))
    save_turned(path, stored, orientation)
    shown = TURNS[orientation](stored)
    found = read_picture(path)
    assert (found.size, found.orientation) == (shown.shape[1::-1], orientation)
    np.testing.assert_allclose(found.pixels.astype(int), shown.astype(int), atol=3 if suffix == ".jpg" else 0)
    assert read_picture(path, largest=1).size == found.size


@pytest.fixture
def turned(tmp_path):
    """A dataset of one photograph that is stored on its side; record and box are those of the displayed picture."""
    save_turned(tmp_path / "a.png", np.kron(COLOR, np.ones((32, 32, 1), np.uint8)), 6)
    image = {"file_name": "a.png", "width": 64, "height": 96}
    return write_dataset(tmp_path, [image], [{"image_id": 1, "bbox": [32, 0, 32, 32]}])


def test_every_reader_uses_the_displayed_picture(turned):
    shown = np.rot90(np.kron(COLOR, np.ones((32, 32, 1), np.uint8)), -1)
    np.testing.assert_array_equal(np.asarray(Dataset.read(turned).picture(0, labels=False)), shown)
    np.testing.assert_array_equal(read_classes_and_sources({"real": turned})[1][0].read_sample(0).picture, shown)
    (label,) = Dataset.read(turned).images[0].labels
    drawn = picture_with_labels(Image.fromarray(shown), [Overlay(label.bbox, 1, "tank")])
    sheet = np.asarray(Dataset.read(turned).sheet(columns=1, tile_width=64).convert("RGB"))
    assert (sheet[..., :].reshape(-1, 3) == np.asarray(drawn)[16, 48]).all(axis=1).any()


def test_verify_reports_orientation_and_compares_displayed_sizes(turned):
    (finding,) = verify_dataset(turned)
    assert finding.severity == "warning"
    assert "EXIF orientation 6" in finding.problem
    path = turned / "annotations.json"
    path.write_text(path.read_text().replace('"width": 64, "height": 96', '"width": 96, "height": 64'))
    assert any("when displayed" in each.problem and each.severity == "error" for each in verify_dataset(turned))
