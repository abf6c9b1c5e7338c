from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from hulldown.annotate.drawing import IGNORED_COLOR, Overlay, category_color, picture_with_labels
from hulldown.annotate.masks import encode_mask
from hulldown.base.errors import DatasetError, HulldownError
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.table import Dataset
from hulldown.pictures.own_files import require_replaceable_picture, save_picture
from hulldown.pictures.sheets import contact_sheet
from hulldown.tests.builders.editing import append, write_dataset


def gray(width: int = 320, height: int = 180) -> Image.Image:
    return Image.new("RGB", (width, height), (90, 90, 90))


def pixels_of(picture: Image.Image, color: tuple[int, int, int]) -> np.ndarray:
    return (np.asarray(picture) == color).all(axis=2)


def test_outlines_are_just_outside_the_box_and_hide_nothing():
    picture = gray()
    drawn = picture_with_labels(picture, [Overlay(np.array([100.2, 60.7, 40.3, 30.1]), 1, "tank")])
    outline = pixels_of(drawn, category_color(1))
    # The box covers pixels 100 to 140 and 60 to 90.
    assert not outline[60:91, 100:141].any()
    assert outline[59, 99:142].all()
    assert outline[91, 99:142].all()
    assert outline[59:92, 99].all()
    assert outline[59:92, 141].all()
    assert np.array_equal(np.asarray(drawn)[60:91, 100:141], np.asarray(picture)[60:91, 100:141])
    assert np.array_equal(np.asarray(picture), np.asarray(gray()))


@pytest.mark.parametrize("bbox", [[-50, -50, 10, 10], [400, 300, 10, 10], [20, 20, -9, -9], [320, 180, 0, 0]])
def test_a_box_outside_its_picture_is_drawn_at_the_edge(bbox):
    outline = pixels_of(picture_with_labels(gray(), [Overlay(np.array(bbox), 1, "tank")]), category_color(1))
    assert outline.any()


@pytest.mark.parametrize("bbox", [[0, 0, 320, 180], [0, 0, 20, 20], [300, 160, 20, 20], [100, 5, 30, 170]])
def test_names_are_inside_the_picture(bbox):
    named = [Overlay(np.array(bbox), 2, name) for name in ("i", "truck" * 4)]
    outline = pixels_of(
        picture_with_labels(gray(), [replace(named[0], ignored=True)]), IGNORED_COLOR
    )  # ignored ones have no name
    short, long = (pixels_of(picture_with_labels(gray(), [box]), category_color(2)) & ~outline for box in named)
    # The name's background, but for the letters: 10 pixels high at least, and a third as wide for each letter.
    assert short.sum() >= 30
    assert long.sum() >= 10 * 20 * 3


def test_masks_are_tinted_exactly():
    mask = np.zeros((180, 320), dtype=bool)
    mask[80:90, 120:130] = True
    drawn = np.asarray(
        picture_with_labels(
            gray(), [Overlay(np.array([100, 60, 60, 50]), 1, "tank", record={"segmentation": encode_mask(mask)})]
        )
    )
    assert (drawn[mask] == np.round(0.6 * 90 + 0.4 * np.array(category_color(1)))).all()
    assert (drawn[60:110, 100:160][~mask[60:110, 100:160]] == 90).all()


@pytest.mark.parametrize(("count", "columns", "rows"), [(1, 1, 1), (3, 3, 1), (4, 3, 2), (7, 3, 3)])
def test_contact_sheet_has_rows_and_columns(count, columns, rows):
    sheet = contact_sheet([gray()] * count, columns=3, tile_width=160)
    gap = 2
    assert sheet.size == (columns * (160 + gap) + gap, rows * (90 + gap) + gap)


def test_captions_need_room_and_match_the_pictures():
    plain, captioned = contact_sheet([gray()]), contact_sheet([gray()], captions=["hills, shot 3"])
    assert captioned.height > plain.height
    long = contact_sheet([gray()] * 2, captions=["a long caption " * 20, ""])
    assert long.height > captioned.height
    beside = np.asarray(long)[:, -480 - 6 :]
    assert (beside == contact_sheet([gray()]).getpixel((0, 0))).all(axis=2)[-40:].all()
    name = contact_sheet([gray()] * 2, captions=["a_name_without_a_space_" * 9, ""])
    assert (np.asarray(name)[-40:, -480 - 6 :] == contact_sheet([gray()]).getpixel((0, 0))).all()
    with pytest.raises(ValueError, match="captions: expected 1, one for each picture, got 2"):
        contact_sheet([gray()], captions=["a", "b"])
    with pytest.raises(ValueError, match="pictures: expected at least one"):
        contact_sheet([])


def test_masks_of_a_dataset_are_shown_on_request(tmp_path):
    mask = np.zeros((180, 320), dtype=bool)
    mask[80:90, 120:130] = True
    with CocoDataset.open(tmp_path) as dataset:
        label = {"category": "tank", "bbox": [100, 60, 60, 50], "segmentation": encode_mask(mask)}
        append(dataset, "images/1.png", gray(), [label])
    tinted, plain = (np.asarray(Dataset.read(tmp_path).picture(0, masks=masks))[mask] for masks in (True, False))
    assert (tinted != 90).all()
    assert (plain == 90).all()


def test_sheet_of_a_dataset(tmp_path):
    label = {"category": "tank", "bbox": [30, 10, 20, 20]}
    with CocoDataset.open(tmp_path) as dataset:
        for i in range(9):
            append(dataset, f"images/{i}.png", Image.new("RGB", (64, 36), (10 * i, 0, 0)), [label])
    sheet = np.asarray(Dataset.read(tmp_path).sheet(count=3, columns=3, tile_width=64))
    # First, middle, and last.
    assert [int(sheet[2 + 33, 2 + i * 66 + 5, 0]) for i in range(3)] == [0, 40, 80]
    (tmp_path / "images" / "8.png").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"8\.png: cannot be read as a picture"):
        Dataset.read(tmp_path).sheet()


def test_the_error_of_a_mask_that_cannot_be_drawn_names_it(tmp_path):
    write_dataset(tmp_path, [{"file_name": "1.png"}], [{"image_id": 1, "bbox": [4, 4, 8, 8], "segmentation": [1]}])
    with pytest.raises(DatasetError, match=r"1\.png: segmentation: expected polygons.*hulldown verify"):
        Dataset.read(tmp_path).sheet()


def test_a_sheet_without_pictures_is_an_error(tmp_path):
    CocoDataset.open(tmp_path).close()
    with pytest.raises(DatasetError, match="has no images yet; render some first"):
        Dataset.read(tmp_path).sheet()


def test_only_pictures_by_hulldown_are_replaced(tmp_path):
    path = tmp_path / "tank.png"
    gray().save(path)
    before = path.read_bytes()
    with pytest.raises(HulldownError, match=r"tank\.png: exists and isn't a picture by hulldown; name another"):
        save_picture(gray(), path)
    assert path.read_bytes() == before
    path.unlink()
    save_picture(gray(), path)
    save_picture(gray(), path)
    require_replaceable_picture(path)
    assert [found.name for found in tmp_path.iterdir()] == ["tank.png"]
