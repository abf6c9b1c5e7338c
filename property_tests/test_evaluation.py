"""Properties of evaluation, for any detector on any dataset."""

import copy

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from hulldown.tests.builders.detections import matched, random_case, total
from hulldown.tests.training.test_matching import assert_official
from hulldown.training.evaluation.bootstrap import share_interval
from hulldown.training.evaluation.metrics import confusion_matrix

CASES = st.builds(
    random_case,
    st.integers(0, 2**32 - 1),
    images=st.integers(1, 6),
    classes=st.integers(1, 3),
    per_image=st.integers(0, 8),
    crowds=st.sampled_from([0.0, 0.2]),
    ties=st.booleans(),
)
THRESHOLDS = st.sampled_from([0.0, 0.3, 0.5, 0.9])


def sums(coco, found, threshold):
    return total(matched(coco, found).with_threshold(threshold))


@given(CASES)
def test_every_match_equals_pycocotools(case):
    assert_official(*case)


@given(CASES, THRESHOLDS, st.randoms(use_true_random=False))
def test_the_order_of_images_categories_and_detections_does_not_matter(case, threshold, random):
    coco, found = case
    shuffled, mixed = copy.deepcopy(coco), list(found)
    for records in (shuffled["images"], shuffled["categories"], mixed):
        random.shuffle(records)
    assert np.allclose(sums(coco, found, threshold), sums(shuffled, mixed, threshold), rtol=1e-12)


@given(CASES, THRESHOLDS)
def test_counts_agree_with_labels_detections_and_confusion(case, threshold):
    matching = matched(*case)
    tp, fp, fn = sums(*case, threshold)[:3]
    assert tp + fn == (~matching.labels.crowd).sum()
    assert tp + fp == (~matching.ignored & (matching.predictions.score >= threshold)).sum()
    matrix = confusion_matrix(matching.with_threshold(threshold))
    assert (np.trace(matrix), matrix[:, :-1].sum(), matrix[:-1].sum()) == (tp, tp + fp, tp + fn)


@example(part=1, whole=2, error=2e-176, freedom=1)
@given(st.integers(0, 1000), st.integers(1, 1000), st.floats(0.0, 0.5), st.integers(1, 300))
def test_an_interval_contains_its_figure(part, whole, error, freedom):
    value = min(part, whole) / whole
    low, high = share_interval(value, error, freedom=freedom, trials=whole)
    assert 0 <= low <= value + 1e-12
    assert value - 1e-12 <= high <= 1
