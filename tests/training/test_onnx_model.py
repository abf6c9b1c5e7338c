"""`hulldown export_model`: onnxruntime gives the detector's results."""

import json
from functools import partial

import numpy as np
import onnxruntime
import pytest
import torch

from hulldown.base.errors import HulldownError
from hulldown.cli import main
from hulldown.tests.builders.networks import CLASSES, nano_weights, write_small_weights
from hulldown.training.detectors import detr
from hulldown.training.inputs.data import pictures_at_network_size
from hulldown.training.onnx_model import export_model
from hulldown.training.predict import load_detector


def decoded(found, width, height):
    """Boxes as corners in pixels, scores, and labels of the best pairs of query and class, RF-DETR's published rule."""
    boxes, logits = found[0][0], found[1][0]
    scores = 1.0 / (1.0 + np.exp(-logits))
    best = np.argsort(-scores, axis=None, kind="stable")[: len(boxes)]
    query, label = best // scores.shape[1], best % scores.shape[1]
    center, half = boxes[query, :2], boxes[query, 2:] / 2
    corners = np.concatenate([center - half, center + half], axis=1) * ([width, height] * 2)
    known = label < len(CLASSES)
    return corners[known], scores.ravel()[best][known], label[known]


@pytest.mark.parametrize("kind", ["small", "nano"])
def test_onnxruntime_gives_the_detectors_results(kind, tmp_path, capsys):
    torch.manual_seed(0)
    weights = tmp_path / "weights"
    if kind == "small":
        write_small_weights(weights)
    else:
        torch.save(nano_weights(tmp_path), weights)
    assert main(["export_model", str(weights), "-o", str(tmp_path / "model.onnx"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["classes"] == list(CLASSES)
    session = onnxruntime.InferenceSession(tmp_path / "model.onnx", providers=["CPUExecutionProvider"])
    assert json.loads(session.get_modelmeta().custom_metadata_map["classes"]) == list(CLASSES)
    detector = load_detector(weights, "cpu")
    rng = np.random.default_rng(0)
    for height, width in ((54, 96), (90, 40)):
        picture = rng.integers(0, 255, (height, width, 3), dtype=np.uint8)
        given = pictures_at_network_size([picture], (64, 64))
        given = given / 255 if kind == "small" else detr.normalize_for_detr(given)
        found = session.run(None, {"input": given.numpy()})
        corners, scores, labels = decoded(found, width, height)
        if kind == "small":  # what it finds is in the picture
            corners = corners.clip(0.0, [width, height] * 2)
        expected = detector.detect([picture])[0]
        assert len(expected.score) > 5
        order, same = (np.argsort(-s, kind="stable") for s in (scores, expected.score))
        close = partial(np.testing.assert_allclose, atol=1e-3, rtol=0)
        close(scores[order], expected.score[same])
        close(corners[order][:, :2], expected.xywh[same][:, :2])
        close((corners[:, 2:] - corners[:, :2])[order], expected.xywh[same][:, 2:])
        np.testing.assert_array_equal(labels[order], expected.class_index[same])


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(HulldownError, match="onnx"):
        export_model(tmp_path, tmp_path / "model.pt")
