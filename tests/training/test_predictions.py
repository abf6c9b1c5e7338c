"""Reading labels and detections: refusals and their messages."""

import json

import numpy as np
import pytest

from hulldown.base.errors import DatasetError
from hulldown.tests.builders.detections import dataset, loaded, results
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.evaluation.predictions import read_predictions

GOOD = {"image_id": 1, "category_id": 1, "bbox": [1, 2, 3, 4], "score": 0.5}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "annotations.json").write_text(json.dumps(dataset([(1, 1, (0, 0, 9, 9))], images=2)))
    return tmp_path


def read(folder, found):
    path = folder / "found.json"
    path.write_text(found if isinstance(found, str) else json.dumps(found))
    return read_predictions(path, read_labels(folder))


def second(**wrong):
    return [GOOD, {**GOOD, **wrong}]


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (second(image_id=7), "detection 1: image 7 is not in the dataset"),
        (second(image_id="1"), "detection 1: image_id is '1'"),
        (second(category_id=None), "detection 1: category_id is None"),
        (second(bbox=[1, 2, 3]), r"detection 1: bbox is \[1, 2, 3\] .* length 4"),
        (second(bbox=[1, 2, -3, 4]), r"detection 1: bbox is \[1, 2, -3, 4\]"),
        (second(bbox=[1, 2, 1e999, 4]), "isn't valid JSON"),
        (second(score=None), "detection 1: score is None"),
        (second(score=1.01), r"detection 1: score is 1.01 .* <= 1\.0"),
        (second(score=-0.1), r"detection 1: score is -0.1 .* >= 0\.0"),
        (second(score=True), "detection 1: score is True"),
        ("", "isn't valid JSON"),
        ("7", "isn't COCO results"),
        ({"results": []}, "isn't COCO results"),
        ([[]], r"detection 0: \[\] isn't an object"),
        ({"images": [{"id": 1}], "annotations": []}, r"image 2 of .* is not among its images \(1 are missing\)"),
        ({"images": [1, 2, 3], "annotations": []}, r"image 3 is not in .* \(1 are not\)"),
        ({"images": ["a"], "annotations": []}, "'images' isn't a list of image ids"),
    ],
)
def test_results_that_do_not_fit_this_dataset_are_refused(folder, found, words):
    with pytest.raises(DatasetError, match=rf"found\.json: .*{words}"):
        read(folder, found)


def test_predicted_images_are_listed_beside_the_results(folder):
    (folder / "found.json.info.json").write_text(json.dumps({"images": [1]}))
    with pytest.raises(DatasetError, match=r"found\.json\.info\.json: image 2 of"):
        read(folder, [])


def test_results_can_be_a_list_or_inside_an_object(folder):
    for found in ([GOOD], {"images": [{"id": 1}, {"id": 2}], "annotations": [GOOD]}):
        assert read(folder, found).score.tolist() == [0.5]


def test_a_category_that_the_dataset_lacks_is_a_separate_class(folder):
    found = read(folder, [GOOD, {**GOOD, "category_id": 9}])
    assert found.class_names == ("tank", "truck", "category 9")
    assert found.class_index.tolist() == [0, 2]


def test_detections_are_in_a_defined_order():
    boxes = [(1, 1, (0, 0, 9, 9)), (1, 1, (5, 0, 9, 9)), (2, 1, (0, 0, 9, 9)), (1, 2, (0, 0, 9, 9))]
    found = results([(*box, 0.5) for box in boxes])
    forth = loaded(dataset([], images=2), found)[1]
    back = loaded(dataset([], images=2), found[::-1])[1]
    assert np.array_equal(forth.xywh, back.xywh)
    assert forth.image.tolist() == [0, 0, 0, 1]
    assert forth.class_index.tolist() == [0, 0, 1, 0]


@pytest.mark.parametrize("name", ["annotations.json", "_annotations.coco.json", "test.json"])
def test_labels_are_read_from_a_dataset_a_split_or_a_file(tmp_path, name):
    path = tmp_path / name
    path.write_text(json.dumps(dataset([(1, 1, (0, 0, 9, 8))])))
    labels = read_labels(path if name == "test.json" else tmp_path)
    assert labels.class_names == ("tank", "truck")
    assert labels.area.tolist() == [72]
    assert labels.folder == tmp_path


ONE_LABEL = dataset([(1, 1, (0, 0, 9, 9))])


@pytest.mark.parametrize(
    ("coco", "words"),
    [
        ({**ONE_LABEL, "images": ONE_LABEL["images"] * 2}, "1.png: has the id 1, as has"),
        ({**ONE_LABEL, "categories": ONE_LABEL["categories"] * 2}, "category 1: its id is given twice"),
        (dataset([(9, 1, (0, 0, 1, 1), {"id": 5})]), "annotation 5: image 9 does"),
        (dataset([(1, 8, (0, 0, 1, 1), {"id": 5})]), "annotation 5: category 8 does"),
        (dataset([(1, 1, (0, 0, 1), {"id": 5})]), "annotation 5: bbox"),
        (
            dataset([(1, 1, (0, 0, 1, 1), {"area": area}) for area in (None, 1.0, "big")]),
            "annotation 3: area is 'big'",
        ),
        ({**ONE_LABEL, "annotations": [{"image_id": 1}]}, "annotation"),
        ([], "is a JSON list, not a dataset"),
    ],
)  # fmt: skip
def test_unusable_labels_are_named(tmp_path, coco, words):
    path = tmp_path / "test.json"
    path.write_text(json.dumps(coco))
    with pytest.raises(DatasetError, match=words):
        read_labels(path)


def test_a_folder_without_a_dataset_is_refused(tmp_path):
    with pytest.raises(DatasetError, match=r"no annotations\.json and no .* here"):
        read_labels(tmp_path)
