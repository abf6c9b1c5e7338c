"""COCO's matching compared with pycocotools' own matches."""

import contextlib
import io

import numpy as np
import pytest
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from hulldown.tests.detections import dataset, loaded, random_case, results
from hulldown.training.evaluation.matching import Overlaps, match, overlapping

IOUS = (0.1, 0.5, 0.75, 0.95)


def coco_of(labels, predictions):
    """The same data in pycocotools' form, with ids from 1, since it takes annotation 0 for unmatched."""
    truth = COCO()
    truth.dataset = {
        "images": [{"id": image["id"]} for image in labels.images],
        "categories": [{"id": c + 1} for c in range(len(predictions.class_names))],
        "annotations": [
            {
                "id": k + 1,
                "image_id": labels.images[labels.image[k]]["id"],
                "category_id": int(labels.label[k]) + 1,
                "bbox": labels.xywh[k].tolist(),
                "area": float(labels.area[k]),
                "iscrowd": int(labels.crowd[k]),
            }
            for k in range(len(labels.image))
        ],
    }
    found = [
        {
            "image_id": labels.images[predictions.image[k]]["id"],
            "category_id": int(predictions.label[k]) + 1,
            "bbox": predictions.xywh[k].tolist(),
            "score": float(predictions.score[k]),
        }
        for k in range(len(predictions.image))
    ]
    return truth, found


def official(labels, predictions, ious=IOUS):
    """pycocotools' decisions: by IoU, detection -> label, and ignored detections, as indices."""
    truth, found = coco_of(labels, predictions)
    with contextlib.redirect_stdout(io.StringIO()):
        truth.createIndex()
        if not found:
            return {iou: ({}, set(), set()) for iou in ious}
        evaluation = COCOeval(truth, truth.loadRes(found), "bbox")
        evaluation.params.iouThrs = np.array(ious)
        evaluation.params.areaRng, evaluation.params.areaRngLbl = [[0, 1e10]], ["all"]
        evaluation.evaluate()
    answers = {}
    for t, iou in enumerate(ious):
        matches, ignored, seen = {}, set(), set()
        for image in filter(None, evaluation.evalImgs):
            ids = [i - 1 for i in image["dtIds"]]
            seen |= set(ids)
            matches |= {d: int(g) - 1 for d, g in zip(ids, image["dtMatches"][t], strict=True) if g > 0}
            ignored |= {d for d, out in zip(ids, image["dtIgnore"][t], strict=True) if out}
        answers[iou] = matches, ignored, seen
    return answers


def assert_official(coco, found):
    labels, predictions = loaded(coco, found)
    pairs = overlapping(labels, predictions)
    for iou, (matches, ignored, seen) in official(labels, predictions).items():
        matched = match(labels, predictions, pairs, iou=iou)
        assert {d: int(g) for d, g in enumerate(matched.box) if g >= 0} == matches
        beyond = set(range(len(predictions.score))) - seen
        assert set(np.flatnonzero(matched.ignored)) == ignored | beyond
        real = {g: d for d, g in matches.items() if not labels.crowd[g]}
        assert {g: int(d) for g, d in enumerate(matched.detection) if d >= 0} == real


def test_more_than_a_hundred_detections_in_an_image():
    coco, _ = random_case(1, images=2, classes=2, per_image=30)
    rng = np.random.default_rng(0)
    found = [
        (1 + int(rng.integers(2)), 1 + int(rng.integers(2)), [*rng.integers(0, 60, 2), 20, 20], rng.integers(9) / 9)
        for _ in range(700)
    ]
    assert_official(coco, results(found))


HARD = {
    "no detections": ([(1, 1, (0, 0, 9, 9))], []),
    "no labels": ([], [(1, 1, (0, 0, 9, 9), 0.5)]),
    "a class only in the labels": ([(1, 1, (0, 0, 9, 9))], [(1, 2, (0, 0, 9, 9), 0.5)]),
    "a category that the dataset lacks": ([(1, 1, (0, 0, 9, 9))], [(1, 7, (0, 0, 9, 9), 0.5)]),
    "boxes without area": ([(1, 1, (5, 5, 0, 0))], [(1, 1, (5, 5, 0, 0), 0.5), (1, 1, (0, 0, 9, 0), 0.5)]),
}  # fmt: skip


@pytest.mark.parametrize("case", HARD)
def test_hard_cases_are_matched_like_pycocotools(case):
    boxes, found = HARD[case]
    assert_official(dataset(boxes), results(found))


def test_pairs_do_not_depend_on_the_block_size(monkeypatch):
    labels, predictions = loaded(*random_case(3))
    whole = overlapping(labels, predictions)
    monkeypatch.setattr("hulldown.training.evaluation.matching.PAIRS_AT_ONCE", 7)
    pieces = overlapping(labels, predictions)
    assert len(whole.box) > 50
    for key in Overlaps.__slots__:
        assert np.array_equal(getattr(whole, key), getattr(pieces, key))
