"""Boxes of photographs from COCO files of any tool, relative to their pictures."""

import json

import numpy as np
import pytest
from PIL import Image

from hulldown.base.errors import DatasetError
from hulldown.dataset.photographs import read_photographs
from hulldown.tests.builders.detections import dataset

IMAGES = [
    {"id": 7, "file_name": "b.jpg", "width": 400, "height": 200},
    {"id": 8, "file_name": "a.jpg", "width": 1000, "height": 500},
    {"id": 9, "file_name": "none.jpg", "width": 10, "height": 10},
]


def coco(*boxes, images=IMAGES):
    return {**dataset([(image, 1, *box) for image, *box in boxes]), "images": images}


def read(folder, content, name="_annotations.coco.json"):
    (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    return read_photographs(folder)


def test_boxes_are_relative_to_their_pictures_and_in_the_frame(tmp_path):
    content = coco((8, [900, 100, 100.8, 50]), (7, [100, 50, 80, 40]))
    content["annotations"] += [{"id": 9, "image_id": 7, "category_id": 1, "bbox": [0, 0, 400, 200], "iscrowd": 1}]
    found = read(tmp_path, content)
    assert found.file_names == ("b.jpg", "a.jpg", "none.jpg")
    assert [found.class_names[i] for i in found.class_index] == ["tank", "tank"]
    np.testing.assert_allclose(found.relative, [[0.25, 0.25, 0.2, 0.2], [0.9, 0.2, 0.1, 0.1]], rtol=1e-12)
    np.testing.assert_allclose(found.aspect, [2.0, 2.0], rtol=1e-12)
    assert found.count.tolist() == [1, 1, 0]
    assert found.cut.tolist() == [[False] * 4, [False, False, True, False]]


def test_a_yolo_folder_is_read_as_training_reads_it(tmp_path):
    for name in ("images", "labels"):
        (tmp_path / name).mkdir()
    Image.new("RGB", (400, 200)).save(tmp_path / "images" / "a.png")
    (tmp_path / "labels" / "a.txt").write_text("1 0.35 0.3 0.2 0.2\n")
    (tmp_path / "data.yaml").write_text("names: [truck, tank]\n")
    found = read_photographs(tmp_path)
    assert [found.class_names[i] for i in found.class_index] == ["tank"]
    np.testing.assert_allclose(found.relative, [[0.25, 0.2, 0.2, 0.2]], rtol=1e-12)
    assert found.sha256 == read_photographs(tmp_path).sha256


def test_a_box_with_a_truncated_fraction_of_0_is_not_cut(tmp_path):
    content = coco((7, [0, 0, 80, 40]))
    content["annotations"][0]["truncated_fraction"] = 0.0
    assert not read(tmp_path, content, "annotations.json").cut.any()


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("{", "a COCO object"),
        ([], "is a JSON list, not a dataset"),
        (coco(images=IMAGES[:1] * 2), "has the id 7, as has"),
        (coco(images=[{**IMAGES[0], "id": "x"}]), "not a whole number"),
        (coco((7, [1, 2, 3])), "bbox is"),
        (coco((7, [100, 50, 400, 90])), "leaves its image by 100 px"),
        (coco((7, [10, 10, 0, 5])), "no area"),
        (coco((7, [0.25, 0.2, 0.3, 0.4])), "no box is 2 px wide or high"),
        (coco((7, [10, 10, 90, 50], {"attributes": {"rotation": 35.0}})), "1 boxes are CVAT's rotated"),
        (coco((6, [1, 2, 3, 4])), "image 6"),
        (coco(images=[{**IMAGES[0], "width": 0}]), "width is 0"),
    ],
)
def test_the_error_of_an_invalid_coco_file_names_it(tmp_path, content, problem):
    with pytest.raises(DatasetError, match=problem) as caught:
        read(tmp_path, content)
    assert caught.value.path.name == "_annotations.coco.json"
    assert caught.value.remedy


def test_pictures_of_another_size_than_their_record_are_refused(tmp_path):
    Image.new("RGB", (200, 100)).save(tmp_path / "b.jpg")
    with pytest.raises(DatasetError, match=r"b\.jpg: is 200 x 100 pixels, its record has 400 x 200"):
        read(tmp_path, coco((7, [100, 50, 80, 40])))


def test_folders_without_labels_are_refused(tmp_path):
    for path, problem in ((tmp_path, "no annotations"), (tmp_path / "nothing", "does not exist")):
        with pytest.raises(DatasetError, match=problem):
            read_photographs(path)
