"""Datasets next to photographs: distributions of boxes, brightness, and contrast, and their distances."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from hulldown.base.errors import DatasetError
from hulldown.cli import main
from hulldown.dataset.photographs import read_photographs
from hulldown.dataset.reports.dataset_report import (
    REPORT_FEATURES,
    brightness_and_contrast,
    compare_with_photographs,
    report_dataset,
)
from hulldown.dataset.table import Dataset
from hulldown.tests.builders.editing import write_dataset

WIDTH, HEIGHT = 64, 48


def coco(folder, count, *, seed, height=0.3, x=0.5, bright=90):
    """A dataset of one box a picture, with scattered heights and positions."""
    rng = np.random.default_rng(seed)
    (folder / "images").mkdir(parents=True)
    images, labels = [], []
    for i in range(count):
        images.append({"file_name": f"images/{i}.png", "width": WIDTH, "height": HEIGHT})
        h = HEIGHT * height * np.exp(0.1 * rng.standard_normal())
        left = np.clip(WIDTH * (x + 0.05 * rng.standard_normal()) - h / 2, 1, WIDTH - h - 1)
        box = [float(left), float(rng.uniform(5, HEIGHT - 5 - h)), float(h), float(h)]
        labels.append({"image_id": i + 1, "bbox": box})
        noise = rng.normal(bright, 20, (HEIGHT, WIDTH, 3)).clip(0, 255).astype(np.uint8)
        Image.fromarray(noise).save(folder / images[i]["file_name"])
    return write_dataset(folder, images, labels)


def compared(folder, photographs):
    return compare_with_photographs(Dataset.read(folder), read_photographs(photographs), pixels=True)


def test_distances_of_equal_distributions_are_small(tmp_path):
    found = compared(coco(tmp_path / "a", 80, seed=1), coco(tmp_path / "b", 80, seed=2))
    assert set(found.distances()) == set(REPORT_FEATURES)
    assert max(found.distances().values()) < 0.3


def test_differences_are_shown_with_their_keys(tmp_path, capsys):
    own = coco(tmp_path / "a", 60, seed=1, height=0.6, x=0.5, bright=150)
    photographs = coco(tmp_path / "b", 60, seed=2, height=0.2, x=0.5, bright=90)
    page = tmp_path / "page.html"
    command = ["report", str(own), "-o", str(page), "--beside", str(photographs)]
    assert main(command) == 0
    assert "1.00  box height / picture height (camera.target_fraction or camera.like)" in capsys.readouterr().out
    assert main([*command, "--json"]) == 0
    distances = json.loads(capsys.readouterr().out)
    assert {name for name, distance in distances.items() if distance == 1.0} == {"height", "brightness"}
    assert "Next to the photographs" in page.read_text()


def test_photographs_without_files_are_compared_by_boxes(tmp_path):
    own, photographs = coco(tmp_path / "a", 6, seed=1), coco(tmp_path / "b", 6, seed=2)
    shutil.rmtree(photographs / "images")
    with pytest.warns(UserWarning, match="only boxes"):
        found = report_dataset(own, tmp_path / "page.html", photographs=photographs)
    assert set(REPORT_FEATURES) - set(found.distances()) == {"brightness", "contrast"}


def test_photographs_without_boxes_are_refused(tmp_path):
    with pytest.raises(DatasetError, match="no boxes"):
        compared(coco(tmp_path / "a", 4, seed=1), coco(tmp_path / "none", 0, seed=1))


def test_brightness_and_contrast_of_even_and_split_pictures():
    red = Image.new("RGB", (40, 40), (255, 0, 0))
    np.testing.assert_allclose(brightness_and_contrast(red), [0.2126, 0.0], atol=1e-12)
    red.paste((255, 255, 255), (0, 0, 40, 20))
    np.testing.assert_allclose(brightness_and_contrast(red), [0.6063, 0.3937], atol=1e-12)
