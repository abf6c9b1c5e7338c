"""Boxes that leave their images: slight cases are clipped, all others are listed together."""

import json

import numpy as np
import pytest

from hulldown.base.errors import DatasetError
from hulldown.dataset.exports.export import export_dataset
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.editing import write_dataset
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.inputs.sources import read_classes_and_sources


def dataset(folder, *boxes):
    return write_dataset(folder / "set", [{"file_name": "a.png"}], [{"image_id": 1, "bbox": list(box)} for box in boxes])


def exported(folder, out, **options):
    export_dataset(folder, out, fractions=(1.0, 0.0, 0.0), **options)
    coco = json.loads((out / "train" / "_annotations.coco.json").read_text())
    return [label["bbox"] for label in coco["annotations"]]


def test_a_box_slightly_outside_is_clipped(tmp_path):
    folder = dataset(tmp_path, (-0.004, 2, 10, 5), (30, 20, 2.9, 4.5))
    clipped = [[0, 2, 9.996, 5], [30, 20, 2, 4]]
    np.testing.assert_allclose(read_classes_and_sources({"real": folder})[1][0].xywh, clipped, atol=1e-12)
    assert [(each.severity, each.figure) for each in verify_dataset(folder)] == [
        ("warning", 0.004),
        ("warning", pytest.approx(0.9)),
    ]
    np.testing.assert_allclose(exported(folder, tmp_path / "out"), clipped, atol=1e-12)


@pytest.mark.parametrize("use", [lambda folder, out: read_classes_and_sources({"real": folder}), export_dataset])
def test_all_other_boxes_are_listed_together(tmp_path, use):
    folder = dataset(tmp_path, (-5, 2, 10, 5), (1, 1, 4, 4), (30, 20, 9, 4), (3, 3, 0, 4))
    with pytest.raises(DatasetError) as error:
        use(folder, tmp_path / "out")
    assert all(f"annotation {k} " in str(error.value) for k in (1, 3, 4))
    assert "annotation 2 " not in str(error.value)
    assert "--clip" in error.value.remedy
    assert not (tmp_path / "out").exists()


def test_export_clips_all_boxes_on_request(tmp_path):
    folder = dataset(tmp_path, (-5, 2, 10, 5), (30, 20, 9, 9), (40, 2, 9, 9), (1, 1, 4, 4))
    assert exported(folder, tmp_path / "out", clip=True) == [[0, 2, 5, 5], [30, 20, 2, 4], [1, 1, 4, 4]]


def test_evaluation_refuses_negative_sizes(tmp_path):
    with pytest.raises(DatasetError, match="negative width or height: annotation 2"):
        read_labels(dataset(tmp_path, (1, 1, 4, 4), (9, 9, -4, 4)))
