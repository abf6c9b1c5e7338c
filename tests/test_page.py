"""Parts of pages in a real browser."""

import io

import pytest
from PIL import Image
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select

from hulldown.dataset.reports.page import Charts, Facet, Gallery, Items, PageSection, Table, Tile, Words, page

FACETS = [Facet("outcome", "outcome", ("missed", "found")), Facet("side_seen", "side", ("front", "rear", "<none>"))]


def picture():
    file = io.BytesIO()
    Image.new("RGB", (40, 30), (200, 80, 0)).save(file, "JPEG")
    return file.getvalue()


def tiles():
    values = [("missed", "front"), ("missed", "rear"), ("found", "front"), ("found", "<none>"), ("found", None)]
    return [
        Tile(picture(), (f"tank {k} & <b>co</b>", "line"), {"outcome": a} | ({"side_seen": b} if b else {}))
        for k, (a, b) in enumerate(values)
    ]


@pytest.fixture
def shown(browser, tmp_path):
    rows = [["front", "2", "1"], ["rear", "1", "0"]]
    choose = [{"side_seen": "front"}, {"side_seen": "rear"}]
    path = tmp_path / "page.html"
    path.write_text(
        page(
            "A & <B>",
            [
                PageSection(
                    "Numbers", [Words("it's <i>"), Items(["a", "b"]), Table(["", "n", "m"], rows, choose=choose)]
                ),
                PageSection("Shades", [Table(["", "x"], [["a", "1"]], "more", shades=[[0.5]]), Charts([])]),
                PageSection("Pictures", [Gallery(tiles(), FACETS)]),
            ],
        ),
        encoding="utf-8",
    )
    browser.get(path.as_uri())
    yield browser
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []


def visible(browser):
    found = browser.find_elements(By.CSS_SELECTOR, ".tile")
    return [k for k, tile in enumerate(found) if tile.is_displayed()]


def choose(browser, facet, value):
    Select(browser.find_element(By.CSS_SELECTOR, f"select[data-facet={facet}]")).select_by_value(value)


def test_text_is_escaped(shown):
    assert shown.title == "A & <B>"
    assert shown.find_element(By.TAG_NAME, "h1").text == "A & <B>"
    assert shown.find_element(By.CSS_SELECTOR, "section p").text == "it's <i>"
    assert shown.find_element(By.CSS_SELECTOR, ".tile strong").text == "tank 0 & <b>co</b>"


def test_thumbnails_filter_by_every_facet_and_all_come_back(shown):
    counter = shown.find_element(By.CSS_SELECTOR, ".shown")
    assert (visible(shown), counter.text) == ([0, 1, 2, 3, 4], "5 of 5 shown")
    choose(shown, "outcome", "found")
    assert visible(shown) == [2, 3, 4]
    choose(shown, "side_seen", "front")
    assert (visible(shown), counter.text) == ([2], "1 of 5 shown")
    choose(shown, "outcome", "")
    assert visible(shown) == [0, 2]
    choose(shown, "side_seen", "<none>")
    assert visible(shown) == [3]
    shown.find_element(By.CSS_SELECTOR, ".clear").click()
    assert visible(shown) == [0, 1, 2, 3, 4]


def test_pictures_are_embedded_in_the_page(shown):
    widths = shown.execute_script("return [...document.querySelectorAll('.tile img')].map((i) => i.naturalWidth)")
    assert widths == [40] * 5


def test_a_page_cannot_fetch_anything(shown, tmp_path):
    (tmp_path / "spy.png").write_bytes(picture())
    asked = """const done = arguments[0], image = new Image();
        image.onload = () => done("loaded"); image.onerror = () => done("refused"); image.src = "spy.png";"""
    assert shown.execute_async_script(asked) == "refused"
    assert "Content Security Policy" in str(shown.get_log("browser"))


def test_a_facet_with_one_value_is_left_out():
    same = [Tile(picture(), ("a",), {"outcome": "missed"})] * 2
    assert "<select" not in page("", [PageSection("", [Gallery(same, FACETS)])])
