import json
import math

import numpy as np
import pytest
from PIL import Image

from annotate.coco import CocoDataset
from annotate.masks import encode
from annotate.verify import Finding, compare, verify
from geometry.errors import DatasetError

MASK = np.zeros((24, 32), dtype=bool)
MASK[4:10, 5:15] = True
POSE = np.eye(4).tolist()


@pytest.fixture
def dataset(tmp_path):
    (tmp_path / "images").mkdir()
    with CocoDataset.open(tmp_path, categories=["tank", "truck"]) as dataset:
        dataset.run("p" * 64, images=3, annotations=3)
        for i in range(3):
            name = f"images/{i}.png"
            Image.new("RGB", (32, 24), (i, 0, 0)).save(tmp_path / name)
            annotation = {
                "id": i + 1,
                "category": "tank",
                "bbox": [5.0, 4.0, 10.0, 6.0],
                "bbox_amodal": [5.0, 4.0, 10.0, 7.0],
                "visible_fraction": 0.75,
                "truncated_fraction": 1 / 7,
                "segmentation": encode(MASK),
                "area": 60,
                "world_from_vehicle": POSE,
            }
            dataset.append({"id": i + 1, "file_name": name, "width": 32, "height": 24}, [annotation])
    return tmp_path


def damage(folder, change) -> list[Finding]:
    """Findings after `change` was applied to the COCO dictionary."""
    path = folder / "annotations.json"
    coco = json.loads(path.read_text())
    change(coco)
    path.write_text(json.dumps(coco))
    return list(verify(folder))


def test_a_sound_dataset_has_no_findings(dataset, capsys):
    assert list(verify(dataset)) == []
    # pycocotools' own chatter stays away from the user.
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("change", "severity", "text"),
    [
        (lambda c: c["images"][1].update(id=1), "error", "image 1: its id is there 2 times"),
        (
            lambda c: c["images"][1].update(file_name="images/0.png"),
            "error",
            "images/0.png: belongs to 2 image",
        ),
        (lambda c: c["images"][1].update(width=33), "error", "images/1.png: is 32 x 24, its record says 33 x 24"),
        (lambda c: c["images"][1].update(height=None), "error", "image 2: height is None"),
        (lambda c: c["images"][1].update(file_name="images/x.png"), "error", "images/x.png: is missing"),
        (lambda c: c["images"][1].update(file_name="../x.png"), "error", "no path inside the dataset"),
        (lambda c: c["annotations"][1].update(id=1), "error", "annotation 1: its id is there 2 times"),
        (lambda c: c["annotations"][1].update(id=0), "warning", "annotation 0: ids below 1 are taken for unmatched"),
        (lambda c: c["annotations"][1].update(image_id=9), "error", "annotation 2: image 9 does not exist"),
        (lambda c: c["annotations"][1].update(category_id=9), "error", "annotation 2: category 9 does not exist"),
        (lambda c: c["annotations"][1].update(bbox=[5, 4, 28, 6]), "error", "leaves its image of 32 x 24"),
        (lambda c: c["annotations"][1].update(bbox=[5, 4, 0, 6]), "error", "has no area"),
        (lambda c: c["annotations"][1].update(bbox=[5, 4, 6]), "error", "is not [x, y, width, height]"),
        (lambda c: c["annotations"][1].update(bbox=[7, 4, 8, 6]), "error", "beyond its bbox"),
        (lambda c: c["annotations"][1].update(area=61), "error", "area is 61, its mask has 60 pixels"),
        (lambda c: c["annotations"][1]["segmentation"].update(size=[32, 24]), "error", "expected size [24, 32]"),
        (lambda c: c["annotations"][1].update(segmentation=[[1, 2, 3, 4]]), "error", "at least three points"),
        (lambda c: c["annotations"][1].update(visible_fraction=1.5), "error", "visible_fraction is 1.5"),
        (lambda c: c["annotations"][1].update(bbox_amodal=[6, 4, 9, 7]), "error", "is not inside bbox_amodal"),
        (lambda c: c["annotations"][1].update(bbox_amodal=[6, 4, 9]), "error", "bbox_amodal [6, 4, 9] is not [x, y, w"),
        (lambda c: c["annotations"][1].update(category_id=[1]), "error", "category [1] does not exist"),
        (lambda c: c["annotations"][1].update(image_id=[2]), "error", "image [2] does not exist"),
        (lambda c: c["annotations"].append({**c["annotations"][1], "id": 8}), "warning", "repeats class and box"),
        (lambda c: c["categories"].append({"id": 2, "name": "other"}), "error", "category 2: its id is there 2 times"),
        (lambda c: c["categories"].append({"id": 5, "name": "tank"}), "error", "category 'tank': is there 2 times"),
        (lambda c: c["categories"].append({"id": 5, "name": "Tank"}), "warning", "differ in capitals only"),
        (lambda c: c["categories"].append({"id": 5}), "error", "category 5: has no name"),
        (lambda c: (c["images"].pop(), c["annotations"].pop()), "warning", "images/2.png: belongs to no record"),
    ],
)
def test_every_damage_is_found(dataset, change, severity, text):
    findings = damage(dataset, change)
    assert any(text in str(finding) and finding.severity == severity for finding in findings), findings


def test_a_broken_picture_is_found(dataset):
    path = dataset / "images" / "1.png"
    path.write_bytes(path.read_bytes()[:60])
    (finding,) = verify(dataset)
    assert str(finding).startswith("error: images/1.png: cannot be decoded")


def test_equal_pictures_are_found(dataset):
    (dataset / "images" / "2.png").write_bytes((dataset / "images" / "0.png").read_bytes())
    assert list(map(str, verify(dataset))) == ["warning: images/2.png: is the same picture as images/0.png"]


def test_class_counts_are_held_against_the_plan(dataset):
    seen = {"category": "truck", "bbox": [1, 2, 3, 4], "visible_fraction": 0.5}
    # A companion that nothing is seen of gets no label, and is not missed.
    unseen = [{**seen, "visible_fraction": 0.0}, {**seen, "bbox": None}]
    rows = [{"category": "tank", "companions": [seen, *unseen]}, *[{"category": "tank", "companions": []}] * 2]
    plan = dataset / "plan.jsonl"
    plan.write_text("\n".join(map(json.dumps, [{"hulldown_plan": 1}, *rows])) + "\n")
    assert list(map(str, verify(dataset, plan=plan))) == ["warning: category 'truck': 0 of 1 planned are there"]
    plan.write_text("\n".join(map(json.dumps, [{"hulldown_plan": 1}, *rows[1:]])) + "\n")
    assert list(map(str, verify(dataset, plan=plan))) == ["error: category 'tank': 3 are there, 2 were planned"]


def test_no_plan_and_no_dataset_are_explained(dataset, tmp_path_factory):
    with pytest.raises(DatasetError, match="cannot be read as a plan"):
        list(verify(dataset, plan=dataset / "no.jsonl"))
    with pytest.raises(DatasetError, match=r"no annotations\.json"):
        list(verify(tmp_path_factory.mktemp("empty")))


def test_an_interrupted_run_is_said_to_be_one(dataset):
    (dataset / "annotations.json").unlink()
    with pytest.warns(UserWarning, match="is missing"):
        findings = list(verify(dataset))
    assert [str(f) for f in findings] == [
        "warning: annotations.json: is not there yet: the run has not been closed; render again to finish it"
    ]


def test_compare_measures_box_and_mask():
    found = compare([5.2, 4.0, 10.0, 6.4], MASK, segmentation=encode(MASK), visible=MASK)
    assert found.box_error == pytest.approx(0.4)
    assert found.mask_iou == 1.0
    half = MASK.copy()
    half[:7] = False
    assert compare([5, 4, 10, 6], MASK, segmentation=encode(MASK), visible=half).mask_iou == 0.5
    assert math.isnan(compare([5, 4, 10, 6], MASK).mask_iou)


@pytest.mark.parametrize(("bbox", "mask", "error"), [(None, MASK, math.inf), ([5, 4, 10, 6], MASK & False, math.inf)])
def test_compare_with_one_of_the_two_missing(bbox, mask, error):
    assert compare(bbox, mask).box_error == error
    assert compare(None, MASK & False).box_error == 0.0


@pytest.mark.parametrize("header", ["{}", "3", "[1]", "seed = 0"])
def test_a_file_without_a_plans_header_is_no_plan(dataset, header):
    (dataset / "plan.jsonl").write_text(header + "\n")
    with pytest.raises(DatasetError, match=r"plan.jsonl: cannot be read as a plan"):
        list(verify(dataset, plan=dataset / "plan.jsonl"))
