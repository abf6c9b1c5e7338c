import numpy as np
import pytest
from scipy.stats import binomtest

from hulldown.tests.builders.detections import dataset, loaded, matched, random_case, results, total
from hulldown.training.evaluation.average_precision import IOU_THRESHOLDS, resampled_class_aps
from hulldown.training.evaluation.bootstrap import (
    combined_error_and_freedom,
    difference_interval,
    draw_resamples,
    figure_intervals,
    ratio_standard_error,
    resample_sums,
    resampled_standard_error,
    share_interval,
)
from hulldown.training.evaluation.evaluate import Evaluation, Threshold, best_threshold, compare_detectors
from hulldown.training.evaluation.matching import match_at_each_iou
from hulldown.training.evaluation.metrics import (
    RATIO_METRICS,
    confusion_matrix,
    figure_denominators,
    figures_from_sums,
    threshold_curves,
)


def test_real_images_alone_have_the_figures_of_the_papers_figure_9():
    found = figures_from_sums(np.array([688.0, 49, 391, 0, 0, 0]))
    assert [round(100 * float(found[key]), 1) for key in ("precision", "recall", "f1")] == [93.4, 63.8, 75.8]


def test_figures_and_confusion_of_one_image_by_hand():
    boxes = [(1, 1, (0, 0, 10, 10)), (1, 1, (100, 0, 10, 10)), (1, 2, (200, 0, 10, 10)), (1, 2, (300, 0, 10, 10))]
    found = [
        (1, 1, (0, 0, 10, 10), 0.9),
        (1, 3, (100, 0, 10, 10), 0.9),
        (1, 2, (100, 0, 10, 10), 0.8),
        (1, 2, (200, 0, 10, 8), 0.7),
        (1, 1, (400, 0, 10, 10), 0.9),
        (1, 2, (300, 0, 10, 10), 0.2),
    ]
    seen = matched(dataset(boxes), results(found)).with_threshold(0.5)
    assert {key: float(value) for key, value in figures_from_sums(total(seen)).items()} == pytest.approx(
        {"precision": 2 / 5, "recall": 2 / 4, "f1": 4 / 9, "mean_iou": 0.9}
        | {"mean_confidence": 0.84, "mean_confidence_tp": 0.8, "mean_confidence_fp": 2.6 / 3}
    )
    assert confusion_matrix(seen).tolist() == [[1, 0, 1, 0], [0, 1, 0, 1], [0, 0, 0, 0], [1, 1, 0, 0]]


def test_curves_go_through_the_operating_points():
    matching = matched(*random_case(1))
    curve = threshold_curves(matching)
    assert (np.diff(curve["threshold"]) < 0).all()
    for k in range(len(curve["threshold"])):
        figure = figures_from_sums(total(matching.with_threshold(curve["threshold"][k])))
        assert [curve[key][k] for key in RATIO_METRICS] == [figure[key] for key in RATIO_METRICS]
    best = best_threshold(matching.labels, matching.predictions)
    assert curve["f1"][curve["threshold"] == best] == curve["f1"].max()


@pytest.mark.parametrize("seed", range(6))
def test_a_position_drawn_three_times_counts_as_three_images(seed):
    coco, found = random_case(seed, images=6, crowds=0.5, ties=False)
    times = (3, 0, 1, 1, 2, 0)
    copies = list(enumerate((i + 1 for i in np.repeat(np.arange(6), times)), start=1))
    many = dataset([], images=len(copies), classes=("a", "b", "c"))
    boxes, repeated = (
        [{**one, "image_id": k} for k, i in copies for one in records if one["image_id"] == i]
        for records in (coco["annotations"], found)
    )
    drawn, copied = averages(coco, found, times), averages(many | {"annotations": boxes}, repeated, [1] * len(copies))
    assert np.allclose(drawn, copied, rtol=0, atol=1e-12, equal_nan=True)


def averages(coco, found, times):
    """`AP_NAMES` of each class, where each image counts so many times."""
    labels, predictions = loaded(coco, found)
    matchings = match_at_each_iou(labels, predictions, IOU_THRESHOLDS)
    weights = np.bincount(labels.position, weights=times)
    return resampled_class_aps(matchings, np.stack([np.ones_like(weights), weights]))[1]


def counted(found):
    """`metrics.SUM_METRICS` of positions with one label each, without false positives."""
    found = np.asarray(found, dtype=float)
    return np.stack([found, 0 * found, 1 - found, 0.8 * found, found, 0 * found], axis=1)


def intervals(sums):
    return figure_intervals(
        figures_from_sums(sums.sum(axis=0)), figures_from_sums(resample_sums(sums)), figure_denominators(sums)
    )


def recall_interval(sums):
    return intervals(sums)["recall"]


def test_five_found_labels_give_a_wide_interval():
    low, high = recall_interval(counted(np.ones(5)))
    assert (low, high) == (pytest.approx(0.39, abs=0.01), 1.0)
    low, high = recall_interval(counted(np.zeros(5)))
    assert (low, high) == (0.0, pytest.approx(0.61, abs=0.01))
    # Positions of four labels, all found, count as one trial each.
    assert recall_interval(4 * counted(np.ones(5)))[0] == pytest.approx(recall_interval(counted(np.ones(5)))[0])


def test_a_share_counts_no_more_than_its_trials():
    expected = binomtest(20, 40).proportion_ci(method="wilson")
    found = share_interval(0.5, 0.001, freedom=10_000, trials=40)
    assert found == pytest.approx([expected.low, expected.high], abs=1e-3)


def test_the_error_of_few_groups_is_that_of_their_mean():
    values = np.array([0.0, 1.0, 0.0, 1.0, 1.0])
    found = resampled_standard_error(resample_sums(values[:, None], times=20_000)[:, 0] / 5, 5)
    assert found == pytest.approx(values.std(ddof=1) / np.sqrt(5), rel=0.03)


@pytest.mark.parametrize(("part", "whole"), [(3, 17), (50, 80), (12, 400), (688, 1079)])
def test_for_independent_labels_the_interval_is_wilsons_with_students_quantile(part, whole):
    low, high = recall_interval(counted(np.arange(whole) < part))
    expected = binomtest(part, whole).proportion_ci(method="wilson")
    assert (low, high) == (pytest.approx(expected.low, abs=0.02), pytest.approx(expected.high, abs=0.03))
    assert 0.97 <= (high - low) / (expected.high - expected.low) <= 1 + 2 / whole**0.5


def test_the_delta_method_agrees_with_the_bootstrap():
    rng = np.random.default_rng(0)
    whole = 1.0 + rng.poisson(2.0, 300)
    part = rng.binomial(whole.astype(int), 0.6).astype(float)
    again = resample_sums(np.stack([part, whole], axis=1))
    resampled = resampled_standard_error(again[:, 0] / again[:, 1], 300)
    assert ratio_standard_error(part, whole) == pytest.approx(resampled, rel=0.06)


def paired(changes, labels=100):
    error = np.std(np.append(changes, np.zeros(labels - len(changes)))) / np.sqrt(labels)
    return difference_interval(np.sum(changes) / labels, error, freedom=labels - 1, labels=labels)


def test_a_difference_is_significant_if_enough_labels_changed():
    """One more label found in every tenth position and nothing lost is significant; one gained label isn't."""
    low, high = paired(np.ones(20))
    assert 0 < low < 0.2 < high
    assert paired(np.ones(1))[0] < 0
    assert paired(np.zeros(0))[0] == -paired(np.zeros(0))[1] != 0


def test_a_detector_differs_from_itself_by_no_more_than_the_two_added_labels():
    labels, predictions = loaded(*random_case(0))
    one = Evaluation(labels, predictions, threshold=Threshold(0.5, "given"))
    low, high = np.transpose(list(compare_detectors(one, one).intervals.values()))
    assert (low == -high).all()
    assert 0 < high.min() == high.max() < 3 * np.sqrt(2) / (~labels.crowd).sum()


def test_different_seeds_widen_an_interval():
    error, freedom = combined_error_and_freedom(0.03, 0.04, test_freedom=100, seed_freedom=2)
    assert error == pytest.approx(0.05)
    assert 2 < freedom < 6
    alone, many = combined_error_and_freedom(0.03, 0.0, test_freedom=100, seed_freedom=0)
    assert (alone, many) == (pytest.approx(0.03), pytest.approx(100))


@pytest.mark.parametrize("groups", [7, 70_000])
def test_resamples_have_the_size_of_the_sample(groups):
    drawn = list(draw_resamples(groups, times=70))
    assert len(drawn) == 1 + (groups == 70_000)
    assert [row.sum() for rows in drawn for row in rows] == [groups] * 70


def test_without_data_or_five_positions_there_is_no_interval():
    sums = counted([1, 1, 0, 1])
    assert all(np.isnan(ends).all() for ends in intervals(sums).values())
    assert np.isnan(resampled_standard_error(np.full((10, 2), np.nan), 20)).all()
    assert np.isnan(share_interval(np.nan, np.nan, freedom=5)).all()
