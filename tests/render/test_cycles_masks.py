"""Comparison of annotations with rendered masks, with a stand-in for Cycles."""

import json
import math

import numpy as np
import pytest

from hulldown.annotate.masks import decode_mask, encode_mask
from hulldown.annotate.records import Label
from hulldown.render.cycles_masks import compare_label_with_masks, verify_masks
from hulldown.render.verify import verify_dataset
from hulldown.tests.builders.render_plans import CUBES, make_row, write_plan

MASK = np.zeros((24, 32), dtype=bool)
MASK[4:10, 5:15] = True


@pytest.fixture
def rendered(tmp_path, render, monkeypatch):
    """A function from a plan's rows to the plan, its dataset's annotations.json, and the records in it.

    Cycles' masks are replaced by the annotated ones.
    """

    def make(rows):
        plan, path = write_plan(tmp_path, rows), tmp_path / "d" / "annotations.json"
        render(plan, tmp_path / "d")
        coco = json.loads(path.read_text())
        masks = np.array([decode_mask(label["segmentation"], 16, 16) for label in coco["annotations"]])
        alone = masks.reshape(len(rows), -1, 16, 16)
        alone = alone * np.arange(1, alone.shape[1] + 1)[:, None, None]
        shown = np.concatenate([alone.max(axis=1, keepdims=True), alone], axis=1)
        monkeypatch.setattr(
            "hulldown.render.cycles_masks.render_index_maps_of_rows", lambda plan, chosen, *_, **__: [shown[i] for i in chosen]
        )
        return plan, path, coco

    return make


@pytest.mark.parametrize(
    "change",
    [
        *({"segmentation": wrong} for wrong in ([1], {"size": [16, 16], "counts": [400]}, 7)),
        *({"bbox": wrong} for wrong in (None, [1, 2, 3], "x")),
    ],
)
def test_a_damaged_label_is_a_finding_and_others_are_measured(rendered, change):
    plan, path, coco = rendered([make_row(i) for i in range(2)])
    first, second = coco["annotations"]
    path.write_text(json.dumps({**coco, "annotations": [{**first, **change}, second]}))
    report = verify_masks(path.parent, plan, count=2, library=CUBES)
    (finding,) = report.findings
    assert (finding.severity, finding.where) == ("error", "images/00000001.png, cube")
    assert "cannot be held against a mask" in finding.problem
    assert [row.mask_iou for row in report.rows] == [1.0]


def test_the_box_of_a_label_without_a_mask_is_measured(rendered):
    plan, path, coco = rendered([make_row(0)])
    (label,) = coco["annotations"]
    bare = {key: value for key, value in label.items() if key not in ("segmentation", "area")}
    path.write_text(json.dumps({**coco, "annotations": [bare]}))
    report = verify_masks(path.parent, plan, count=1, library=CUBES)
    assert (report.findings, [row.box_error for row in report.rows]) == ((), [0.0])


@pytest.mark.parametrize("deleted", [3, 4])
def test_a_deleted_label_is_a_warning_and_others_keep_their_masks(rendered, deleted):
    pose = np.eye(4)
    pose[1, 3] = 2.5
    (other,) = make_row(0, world_from_vehicle=pose.tolist(), bbox=[2.0, 6.0, 4.0, 4.0])["planned"]
    plan, path, coco = rendered([make_row(i, companions=[other]) for i in range(2)])
    left = [label for label in coco["annotations"] if label["id"] != deleted]
    by_hand = {**coco["annotations"][0], "id": 99, "image_id": 2}
    path.write_text(json.dumps({**coco, "annotations": [*left, by_hand]}))
    report = verify_masks(path.parent, plan, count=2, library=CUBES)
    expected = "error: images/00000002.png: box 'cube' is planned and has no annotation"
    assert [str(finding) for finding in report.findings] == [expected]
    assert [row.mask_iou for row in report.rows] == [1.0, 1.0, 1.0]
    assert expected in [str(finding) for finding in verify_dataset(path.parent, plan=plan)]


def label(**fields):
    return Label.from_record({"id": 1, "image_id": 1, "category_id": 1, **fields}, {})


def test_box_and_mask_are_measured():
    found = compare_label_with_masks(
        "1.png", "cube", label(bbox=[5.2, 4.0, 10.0, 6.4], segmentation=encode_mask(MASK)), MASK, MASK
    )
    assert (found.pixels, found.box_error, found.outside) == (60, pytest.approx(0.4), pytest.approx(0.2))
    assert found.mask_iou == 1.0
    half = MASK.copy()
    half[:7] = False
    assert (
        compare_label_with_masks(
            "1.png", "cube", label(bbox=[5, 4, 10, 6], segmentation=encode_mask(MASK)), MASK, half
        ).mask_iou
        == 0.5
    )
    assert math.isnan(compare_label_with_masks("1.png", "cube", label(bbox=[5, 4, 10, 6]), MASK, MASK).mask_iou)
    whole = label(bbox=[5, 4, 10, 6], segmentation=encode_mask(half), segmentation_amodal=encode_mask(half))
    found = compare_label_with_masks("1.png", "cube", whole, MASK, half)
    assert (found.mask_iou, found.amodal_iou) == (1.0, 0.5)


def test_an_amodal_mask_that_cycles_does_not_render_is_an_error(rendered):
    plan, path, coco = rendered([make_row(0)])
    (label,) = coco["annotations"]
    assert label["segmentation_amodal"] == label["segmentation"]  # nothing hides the cube
    path.write_text(
        json.dumps({**coco, "annotations": [{**label, "segmentation_amodal": {"size": [16, 16], "counts": [256]}}]})
    )
    (finding,) = verify_masks(path.parent, plan, count=1, library=CUBES).findings
    assert finding.severity == "error"
    assert "amodal mask overlap by 0.000" in finding.problem


def test_the_box_error_of_an_invisible_vehicle_is_infinite():
    assert (
        compare_label_with_masks("1.png", "cube", label(bbox=[5, 4, 10, 6]), MASK & False, MASK & False).box_error == math.inf
    )
