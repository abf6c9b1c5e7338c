"""The page about a dataset, and its contents."""

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select

from hulldown.annotate.masks import encode_mask
from hulldown.base.errors import DatasetError, HulldownError
from hulldown.dataset.reports.dataset_report import report_dataset
from hulldown.dataset.reports.page import Tile, facet_counts
from hulldown.dataset.table import Dataset
from hulldown.tests.builders.editing import write_dataset

WIDTH, HEIGHT = 96, 54


def pose(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Twelve renders of two classes, one of them with two labels, one background, and two photographs."""
    images, labels = [], []
    for i in range(14):
        images.append({"file_name": f"images/{i}.png", "width": WIDTH, "height": HEIGHT})
        if i < 12:
            images[i] |= {"scenery": ("hills", "<steppe>")[i % 2], "hdri": "noon", "position": i // 2, "strength": 1.0}
            images[i] |= {
                "world_from_camera": pose(0.0, -20.0, 5.0).tolist(),
                "weather": {"visibility_m": 300.0} if i == 5 else None,
            }
        mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
        mask[10:20, 20 : 30 + i] = True
        for k in range(0 if i == 7 else 2 if i == 3 else 1):
            label = {"image_id": i + 1, "category_id": 1 + (i + k) % 2}
            label |= {"bbox": [20.0, 10.0 + 20 * k, 10.0 + i, 10.0], "segmentation": encode_mask(mask) if k == 0 else []}
            if i < 12:
                label |= {"vehicle": f"v{k}", "world_from_vehicle": pose(0.0, float(i), 0.0).tolist()}
                label |= {"visible_fraction": 0.5 + i / 24, "truncated_fraction": 0.0}
            labels.append(label)
    return write_dataset(tmp_path_factory.mktemp("A & <B>"), images, labels, names=("tank", "truck & <trailer>"))


@pytest.fixture(scope="module")
def page(folder, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    report_dataset(folder, path)
    return path


@pytest.fixture
def shown(browser, page):
    browser.get(page.as_uri())
    yield browser
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []


def tiles(browser):
    """Numbers of the visible pictures, in order."""
    found = browser.find_elements(By.CSS_SELECTOR, ".tile strong")
    return [int(re.findall(r"\d+", tile.text)[0]) for tile in found if tile.is_displayed()]


def choose(browser, facet, value):
    Select(browser.find_element(By.CSS_SELECTOR, f"select[data-facet={facet}]")).select_by_visible_text(value)


def test_all_images_are_shown_and_counted(shown, folder):
    assert shown.title == shown.find_element(By.TAG_NAME, "h1").text == f"Dataset {folder}"
    assert tiles(shown) == list(range(14))
    assert "images: 14, images without labels: 1, positions: 12, labels: 14, classes: 2." in shown.page_source
    widths = shown.execute_script("return [...document.querySelectorAll('.tile img')].map((i) => i.naturalWidth)")
    assert widths == [WIDTH] * 14


def test_the_page_cannot_fetch_anything(shown, page):
    Image.new("RGB", (4, 3)).save(page.with_name("spy.png"))
    asked = """const done = arguments[0], image = new Image();
        image.onload = () => done("loaded"); image.onerror = () => done("refused"); image.src = "spy.png";"""
    assert shown.execute_async_script(asked) == "refused"
    assert "Content Security Policy" in str(shown.get_log("browser"))


def test_an_image_is_found_by_each_of_its_classes(shown):
    choose(shown, "class", "truck & <trailer> (6)")
    assert tiles(shown) == [1, 3, 5, 9, 11, 13]
    choose(shown, "class", "none (1)")
    assert tiles(shown) == [7]
    choose(shown, "class", "all")
    choose(shown, "weather", "fog, under 500 m (1)")
    assert tiles(shown) == [5]
    assert shown.find_element(By.CSS_SELECTOR, ".shown").text == "1 of 14 shown"
    choose(shown, "scenery", "hills (6)")
    assert tiles(shown) == []
    choose(shown, "weather", "all")
    choose(shown, "scenery", "<steppe> (6)")
    assert tiles(shown) == [1, 3, 5, 7, 9, 11]


def test_a_facet_with_one_value_is_left_out():
    tiles = [Tile(b"", ["a"], {"class": ["tank"], "side": [side] if side else []}) for side in ("front", "")]
    assert facet_counts(tiles) == {"side": {"front": 1}}


def test_a_thumbnail_has_a_caption_and_its_boxes(shown, folder):
    tile = shown.find_elements(By.CSS_SELECTOR, ".tile")[3]
    assert tile.text.startswith("images/3.png\ntruck & <trailer>, v0, 13 x 10 px, 24 m, 62 % visible")
    content = base64.b64decode(tile.find_element(By.TAG_NAME, "img").get_attribute("src").partition(",")[2])
    pixels = np.asarray(Image.open(io.BytesIO(content))).astype(int)
    apart = np.abs(pixels - np.asarray(Image.open(folder / "images/3.png"))).max(axis=2) > 60
    assert apart[9, 22:30].all()  # upper edge of the first box
    assert apart[40, 22:30].all()  # lower edge of the second
    assert not apart[32:38, 22:30].any()


def test_only_a_report_is_overwritten_and_the_same_dataset_gives_the_same(folder, page, tmp_path):
    before = page.read_bytes()
    report_dataset(folder, page, images=2)
    assert page.read_text().count("<button class=tile") == 2
    report_dataset(folder, page)
    assert page.read_bytes() == before
    (tmp_path / "mine.html").write_text("<p>mine</p>")
    with pytest.raises(HulldownError, match=r"mine\.html: exists and isn't a page by hulldown"):
        report_dataset(folder, tmp_path / "mine.html")
    with pytest.raises(HulldownError, match="cannot be written"):
        report_dataset(folder, tmp_path / "mine.html" / "report.html")


def test_a_picture_that_is_missing_is_named(folder, tmp_path):
    (tmp_path / "annotations.json").write_text((folder / "annotations.json").read_text())
    with pytest.raises(DatasetError, match=r"0\.png: is missing"):
        report_dataset(tmp_path, tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()


def test_an_empty_dataset_is_reported(tmp_path):
    with pytest.raises(DatasetError, match="has no images yet"):
        report_dataset(write_dataset(tmp_path, []), tmp_path / "report.html")


def test_photographs_alone_have_a_report(tmp_path):
    report_dataset(write_dataset(tmp_path, [{"file_name": "a.jpg"}], names=()), tmp_path / "report.html")
    assert "images: 1, images without labels: 1, positions: 0, labels: 0, classes: 0." in (tmp_path / "report.html").read_text()


def test_tables_have_equal_lengths_and_known_values(folder):
    dataset = Dataset.read(folder)
    assert {len(column) for column in dataset.labels.values()} == {14}
    assert {len(column) for column in dataset.of_images.values()} == {14}
    labels = dataset.labels
    np.testing.assert_allclose(labels["distance"][0], np.sqrt(20.0**2 + 5.0**2))
    assert np.isnan(labels["distance"][-2:]).all()
    assert labels["scenery"][:2].tolist() == ["hills", "<steppe>"]
    assert [image.labels[0].category for image in dataset.images[:2]] == ["tank", "truck & <trailer>"]
    assert dataset.picture(3).size == (WIDTH, HEIGHT)
    assert dataset.picture(3).getpixel((20, 9)) != dataset.picture(3, labels=False).getpixel((20, 9))
