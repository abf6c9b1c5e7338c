"""`predict --rivals`: a pretrained detector's cars lower the scores of detections there."""

import json
from fractions import Fraction

import numpy as np
import pytest
import torch

from hulldown.base.errors import HulldownError
from hulldown.cli import main
from hulldown.tests.builders.networks import RUN, write_small_weights
from hulldown.tests.builders.training_pictures import make_dataset
from hulldown.training.detectors.detector import Detections
from hulldown.training.detectors.rivals import RIVAL_CLASSES, lower_contested_scores
from hulldown.training.predict import predict_detections


def detections(*rows):
    """`rows`: (xywh, score)."""
    boxes = np.array([box for box, _ in rows], dtype=float).reshape(-1, 4)
    return Detections(boxes, np.array([score for _, score in rows], dtype=float), np.arange(len(rows)))


def overlap(a, b):
    """IoU of two xywh boxes, exactly."""
    (ax, ay, aw, ah), (bx, by, bw, bh) = ([Fraction(n) for n in box] for box in (a, b))
    shared = max(0, min(ax + aw, bx + bw) - max(ax, bx)) * max(0, min(ay + ah, by + bh) - max(ay, by))
    return shared / (aw * ah + bw * bh - shared)


def test_the_highest_overlapping_rival_counts_and_rows_stay_by_falling_score():
    found = detections(([0, 0, 10, 10], 0.75), ([50, 50, 10, 10], 0.5), ([0, 0, 10, 4], 0.25))
    rivals = detections(([0, 0, 10, 5], 0.5), ([0, 0, 10, 10], 0.25), ([50, 50, 4.5, 10], 1.0))
    lowered = lower_contested_scores(found, rivals)
    assert lowered.score.tolist() == [0.5, 0.375, 0.125]  # an IoU of exactly 0.5 counts, one of 0.45 doesn't
    assert lowered.class_index.tolist() == [1, 0, 2]
    assert lowered.xywh.tolist() == found.xywh[[1, 0, 2]].tolist()


@pytest.mark.parametrize("rows", [(), (([3, 4, 5, 6], 0.5),)])
def test_without_rivals_or_detections_nothing_changes(rows):
    assert lower_contested_scores(detections(*rows), detections()).score.tolist() == [0.5] * len(rows)
    assert lower_contested_scores(detections(), detections(*rows)).score.tolist() == []


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A run that started from a detector of cars and buses, and pictures."""
    folder = tmp_path_factory.mktemp("rivals")
    torch.manual_seed(3)
    start = write_small_weights(folder / "start", classes=("car", "person", "bus", "tank"))
    write_small_weights(folder / "run" / "weights", classes=("tank", "bus"))
    settings = {"model": "small", "weights": str(start)}
    config = {"settings": settings, "classes": ["tank", "bus"], "data": {}, "valid": None, "weights_sha256": None}
    (folder / "run" / "run.json").write_text(json.dumps(RUN))
    (folder / "run" / "config.json").write_text(json.dumps(config))
    make_dataset(folder / "pictures", 4)
    return folder


def predicted(folder, weights, **options):
    output = folder / "found.json"
    predict_detections(folder / weights, folder / "pictures" / "images", output, device="cpu", **options)
    return json.loads(output.read_text())


def test_scores_fall_by_the_runs_start_in_classes_that_the_run_lacks(case):
    plain, cars = predicted(case, "run"), [one for one in predicted(case, "start") if one["category_id"] == 1]
    expected = []
    for one in plain:
        near = [car for car in cars if car["image_id"] == one["image_id"] and overlap(one["bbox"], car["bbox"]) >= 0.5]
        expected.append(one["score"] * (1 - max((car["score"] for car in near), default=0)))
    assert 5 < sum(score < one["score"] for score, one in zip(expected, plain, strict=True)) < len(plain)
    lowered = predicted(case, "run", rivals="start")
    assert sorted(one["score"] for one in lowered) == pytest.approx(sorted(expected), abs=1e-12)
    assert predicted(case, "run", rivals=case / "start") == lowered


def test_results_without_rivals_are_not_continued_with_them(case):
    last = max((case / "pictures" / "images").iterdir())
    whole = last.read_bytes()
    last.write_bytes(whole[:50])
    with pytest.raises(HulldownError, match="cannot be read"):
        predicted(case, "run", batch=1)
    last.write_bytes(whole)
    command = ["predict", str(case / "run"), str(case / "pictures" / "images"), "-o", str(case / "found.json")]
    assert main([*command, "--rivals", "start", "--device", "cpu"]) == 0
    assert [one["score"] for one in json.loads((case / "found.json").read_text())] == pytest.approx(
        [one["score"] for one in predicted(case, "run", rivals="start")]
    )


@pytest.mark.parametrize(
    ("weights", "rivals", "words"),
    [
        ("run", "run", f"finds tank, bus, none of {', '.join(sorted({*RIVAL_CLASSES} - {'bus'}))}; name one that was"),
        ("start", "start", r"config\.json: isn.t the config of a run"),
        ("run", "missing.pth", "missing.pth: no such run folder or checkpoint"),
    ],
)
def test_unusable_rivals_are_one_line(case, monkeypatch, weights, rivals, words):
    monkeypatch.chdir(case)
    with pytest.raises(HulldownError, match=words) as error:
        predict_detections(weights, "pictures/images", "found.json", device="cpu", rivals=rivals)
    assert "\n" not in str(error.value)
