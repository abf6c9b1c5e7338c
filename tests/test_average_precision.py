"""Average precision compared with pycocotools, on random sets with crowds, ties, areas, and empty classes."""

import numpy as np
import pytest

from hulldown.tests.detections import loaded, random_case
from hulldown.tests.test_matching import pycocotools_evaluation
from hulldown.training.evaluation.average_precision import average_precision


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


def reference(labels, predictions):
    evaluation = pycocotools_evaluation(labels, predictions)
    precision = evaluation.eval["precision"][:, :, :, 0, -1]
    each = np.where(precision < 0, np.nan, precision).mean(axis=1)
    return evaluation.stats, np.stack([each.mean(axis=0), each[0], each[5]], axis=1)


def compare(seeds):
    compared = 0
    for seed in seeds:
        labels, predictions = case(seed)
        if not len(predictions.score):
            continue
        (summary, own), (stats, each) = average_precision(labels, predictions), reference(labels, predictions)
        theirs = np.where(stats < 0, np.nan, stats)
        assert np.allclose(list(summary.values()), theirs, rtol=0, atol=1e-12, equal_nan=True), seed
        assert np.allclose(own, each, rtol=0, atol=1e-12, equal_nan=True), seed
        compared += 1
    return compared


def test_average_precision_equals_pycocotools_on_random_sets():
    assert compare(range(200)) > 120


@pytest.mark.thorough
def test_average_precision_equals_pycocotools_on_ten_thousand_random_sets():
    assert compare(range(200, 15_700)) >= 10_000
