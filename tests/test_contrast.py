"""Contrast of targets, measured in pictures."""

import numpy as np
import pytest
from PIL import Image

from hulldown.tests.detections import dataset
from hulldown.training.evaluation.bins import fields
from hulldown.training.evaluation.contrast import measured_contrast
from hulldown.training.evaluation.labels import labels_of
from hulldown.training.evaluation.predictions import predictions_of


def rectangle(x, y, w, h):
    return {"segmentation": [[x, y, x + w, y, x + w, y + h, x, y + h]]}


@pytest.fixture
def scene(tmp_path):
    """Gray 100 with a target of 151 and one of 74; a label without a mask; a missing second picture."""
    boxes = [(100, 100, 60, 40), (300, 200, 60, 40)]
    records = [(1, 1, box, rectangle(*box)) for box in boxes] + [
        (1, 1, (0, 0, 9, 9)),
        (2, 1, boxes[0], rectangle(*boxes[0])),
    ]
    pixels = np.full((480, 640, 3), 100, dtype=np.uint8)
    for (x, y, w, h), level in zip(boxes, (151, 74), strict=True):
        pixels[y : y + h, x : x + w] = level
    (tmp_path / "images").mkdir()
    Image.fromarray(pixels).save(tmp_path / "images" / "1.png")
    return labels_of(dataset(records, images=2), path=tmp_path, folder=tmp_path)


def test_contrast_is_the_difference_from_the_surroundings_of_a_target(scene):
    assert measured_contrast(scene) == pytest.approx([51 / 255, 26 / 255, np.nan, np.nan], abs=0.005, nan_ok=True)


def test_a_stored_contrast_overrides_the_measured_one(scene):
    scene.annotations[0]["contrast"] = 0.9
    predictions = predictions_of([], scene, path=scene.path, name="none")
    (contrast,) = [field for field in fields(scene, predictions) if field.name == "contrast"]
    assert [contrast.bins[k] if k >= 0 else None for k in contrast.of_label] == [
        "0.4 and more",
        "0.1 to 0.2",
        None,
        None,
    ]
