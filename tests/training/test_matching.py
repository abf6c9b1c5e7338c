"""Matches and average precision compared with pycocotools', on random sets with crowds, ties, and areas."""

import contextlib
import io

import numpy as np
import pytest
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from hulldown.tests.builders.detections import dataset, loaded, random_case, results
from hulldown.training.evaluation.average_precision import AP_NAMES
from hulldown.training.evaluation.evaluate import Evaluation, Threshold
from hulldown.training.evaluation.matching import match_at_each_iou

IOUS = (0.1, 0.5, 0.75, 0.95)


def pycocotools_evaluation(labels, predictions, **params):
    """pycocotools' evaluation of the same data, numbered from 1, since it takes annotation 0 for unmatched."""
    more = [{"area": area, "iscrowd": crowd} for area, crowd in zip(labels.area, labels.crowd, strict=True)]
    boxes = zip(labels.image + 1, labels.class_index + 1, labels.xywh, more, strict=True)
    found = zip(predictions.image + 1, predictions.class_index + 1, predictions.xywh, predictions.score, strict=True)
    truth = COCO()
    truth.dataset = dataset(boxes, images=len(labels.images), classes=predictions.class_names)
    with contextlib.redirect_stdout(io.StringIO()):
        truth.createIndex()
        evaluation = COCOeval(truth, truth.loadRes(results(found)), "bbox")
        vars(evaluation.params).update(params)
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return evaluation


def official(labels, predictions):
    """pycocotools' decisions: by IoU, detection -> label, and ignored detections, as indices."""
    if not len(predictions.score):
        return {iou: ({}, set(), set()) for iou in IOUS}
    evaluation = pycocotools_evaluation(labels, predictions, iouThrs=np.array(IOUS))
    answers = {}
    for t, iou in enumerate(IOUS):
        matches, ignored, seen = {}, set(), set()
        for image in evaluation.evalImgs:
            if image is None or image["aRng"] != evaluation.params.areaRng[0]:
                continue
            ids = [i - 1 for i in image["dtIds"]]
            seen |= set(ids)
            matches |= {d: int(g) - 1 for d, g in zip(ids, image["dtMatches"][t], strict=True) if g > 0}
            ignored |= {d for d, out in zip(ids, image["dtIgnore"][t], strict=True) if out}
        answers[iou] = matches, ignored, seen
    return answers


def assert_official(coco, found):
    labels, predictions = loaded(coco, found)
    all_matched = match_at_each_iou(labels, predictions, IOUS)
    answers = official(labels, predictions).values()
    for matched, (matches, ignored, seen) in zip(all_matched, answers, strict=True):
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


def test_many_images_are_matched_like_pycocotools():
    coco, found = random_case(3, images=1000)
    assert_official(coco, found)
    assert_official_averages(*loaded(coco, found))


def case(seed):
    rng = np.random.default_rng([seed, 1])
    coco, found = random_case(
        seed, images=int(rng.integers(1, 7)), classes=int(rng.integers(1, 5)), per_image=int(rng.choice([0, 3, 8])),
        crowds=float(rng.choice([0.0, 0.2])), ties=bool(rng.random() < 0.5),
    )  # fmt: skip
    for box in coco["annotations"]:
        if rng.random() < 0.4:  # areas of masks at the limits of COCO's ranges
            box["area"] = float(rng.choice([10.0, 1023.0, 1024.0, 1025.0, 9216.0, 1e5]))
    for box in (*coco["annotations"], *found) if rng.random() < 0.3 else ():
        box["bbox"] = (np.array(box["bbox"]) * rng.uniform(0.5, 12.0, 4)).round(int(rng.integers(4))).tolist()
    return loaded(coco, found * (8 if rng.random() < 0.03 else 1))  # more than a hundred in an image


def assert_official_averages(labels, predictions):
    one = Evaluation(labels, predictions, threshold=Threshold(0.5, "given"))
    theirs = pycocotools_evaluation(labels, predictions)
    precision = theirs.eval["precision"][:, :, :, 0, -1].mean(axis=1)
    each = np.stack([precision.mean(axis=0), precision[0], precision[5]], axis=1)
    ours = [*one.summary.values(), *(one.values(c)[key] for c in range(len(each)) for key in AP_NAMES)]
    official = np.concatenate([theirs.stats, each.ravel()])
    assert np.allclose(ours, np.where(official < 0, np.nan, official), rtol=0, atol=1e-12, equal_nan=True)


def test_recalls_rounded_across_an_edge_count_as_by_division():
    """0.07 of 100 labels is 7.000000000000001 of them in float64; the seventh label reaches that recall."""
    boxes = [(image, 1, (0, 0, 9, 9)) for image in range(1, 101)]
    found = [(image, 1, (x, 0, 9, 9), 1 - (image + x / 99) / 200) for image in range(1, 101) for x in (0, 50)]
    assert_official_averages(*loaded(dataset(boxes, images=100), results(found)))


def compare(seeds):
    cases = [found for found in map(case, seeds) if len(found[1].score)]
    for found in cases:
        assert_official_averages(*found)
    return len(cases)


def test_average_precision_equals_pycocotools_on_random_sets():
    assert compare(range(200)) > 120


@pytest.mark.thorough
def test_average_precision_equals_pycocotools_on_ten_thousand_random_sets():
    assert compare(range(200, 15_700)) >= 10_000
