"""A dataset's annotations against masks; with a stand-in for Cycles."""

import json

import numpy as np
import pytest

from annotate.masks import decode
from annotate.verify import verify
from planning.plan_file import TARGET_KEYS
from render.masks import RowMasks, verify_masks
from render.supervisor import render_plan
from tests.render_plans import ASSETS, make_row, write_plan


@pytest.mark.parametrize("deleted", [3, 4])
def test_a_label_that_was_deleted_is_a_warning_and_others_keep_their_masks(tmp_path, blender, monkeypatch, deleted):
    pose = np.eye(4)
    pose[1, 3] = 2.5
    beside = make_row(0, world_from_vehicle=pose.tolist(), bbox=[2.0, 6.0, 4.0, 4.0])
    other = {key: beside[key] for key in TARGET_KEYS}
    plan = write_plan(tmp_path, [make_row(i, companions=[other]) for i in range(2)])
    render_plan(plan, tmp_path / "d", assets=ASSETS, blender=blender)
    path = tmp_path / "d" / "annotations.json"
    coco = json.loads(path.read_text())

    def as_annotated(plan, rows, *_args, **_options):
        masks = np.array([decode(label["segmentation"], 16, 16) for label in coco["annotations"]])
        return [RowMasks(i, alone=masks[2 * i : 2 * i + 2], visible=masks[2 * i : 2 * i + 2]) for i in rows]

    monkeypatch.setattr("render.masks.cycles_masks", as_annotated)
    left = [label for label in coco["annotations"] if label["id"] != deleted]
    by_hand = {**coco["annotations"][0], "id": 99, "image_id": 2}
    path.write_text(json.dumps({**coco, "annotations": [*left, by_hand]}))
    report = verify_masks(tmp_path / "d", plan, count=2, assets=ASSETS)
    expected = "warning: images/00000002.png: box 'cube' is planned and has no annotation"
    assert [str(finding) for finding in report.findings] == [expected]
    assert [row.mask_iou for row in report.rows] == [1.0, 1.0, 1.0]
    assert expected in [str(finding) for finding in verify(tmp_path / "d", plan=plan)]
