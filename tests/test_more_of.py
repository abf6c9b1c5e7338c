"""Plans with more of what a detector missed."""

import json
from collections import Counter

import numpy as np
import pytest

from hulldown.annotate.attributes import SIDES, sides_of
from hulldown.base.errors import ConfigError
from hulldown.dataset.table import Dataset
from hulldown.planning.check import check_plan
from hulldown.planning.inputs.more_of import MOST, read_more_of
from hulldown.planning.plan.bin_weights import MoreOf
from hulldown.planning.plan_file import read_plan
from hulldown.planning.search.candidates import kept
from hulldown.planning.write import write_plan
from hulldown.tests.editing import write_dataset
from hulldown.tests.planning_assets import small_assets, small_config
from hulldown.training.evaluation.evaluation_report import evaluate_files

ASSETS = small_assets()
CONFIG = small_config(seed=5, budget={"images_per_class": 60, "images_per_position": 1, "background_share": 0.1})
MISSED = MoreOf(weights={"azimuth_seen": {"rear": 4.0, "front": 0.5}, "vehicle": {"leo": 3.0}}, picture_px=1000.0)


def one_bin(name, recall, half, labels=100):
    return {"bin": name, "labels": labels, "recall": recall, "recall_interval": [recall - half, recall + half]}


def report(folder, recall=0.6, **bins):
    path = folder / "report.json"
    path.write_text(json.dumps({"overall": {"recall": recall}, "picture_px": 800.0, "bins": bins}))
    return path


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plans")
    return {
        name: write_plan(CONFIG, ASSETS, folder / f"{name}.jsonl", more_of=more_of)
        for name, more_of in (("plain", None), ("more", MISSED))
    }


def shares(plan, key):
    counts = Counter(key(row) for row in plan if not row.background)
    return {name: n / counts.total() for name, n in counts.items()}


def side(row):
    toward = row.world_from_camera[:3, 3] - row.target.world_from_vehicle[:3, 3]
    forward, left = toward @ row.target.world_from_vehicle[:3, :2]
    return SIDES[int(sides_of(np.degrees(np.arctan2([left], [forward])))[0])]


def test_weights_are_significant_excess_miss_rates(tmp_path):
    path = report(
        tmp_path,
        box_size=[
            one_bin("under 16 px", 0.2, 0.02),
            one_bin("16 to 32 px", 0.2, 0.4),
            one_bin("64 to 96 px", 0.99, 0.01),
        ],
        hdri=[one_bin("noon", 0.6, 0.1), {"bin": "dusk", "recall": None, "recall_interval": [None, None]}],
        contrast=[one_bin("under 0.05", 0.0, 0.01)],
    )  # fmt: skip
    found = read_more_of(path)
    assert found.picture_px == 800.0
    assert found.weights.keys() == {"box_size"}  # contrast isn't planned; for HDRIs nothing is significant
    sizes = found.weights["box_size"]
    assert sizes["under 16 px"] == pytest.approx(0.8 / 0.4, abs=0.01)
    assert 1.0 < sizes["16 to 32 px"] < 1.8
    assert sizes["64 to 96 px"] == 1 / MOST


def test_missed_bins_get_more_images_and_others_keep_their_distribution(plans):
    plain, more = plans["plain"], plans["more"]
    assert len(more) == len(plain)
    assert shares(more, lambda row: row.target.category) == shares(plain, lambda row: row.target.category)
    assert sum(row.background for row in more) == sum(row.background for row in plain)
    sides, sides_more = shares(plain, side), shares(more, side)
    assert sides_more["rear"] > sides["rear"] + 0.15
    vehicles, vehicles_more = (shares(one, lambda row: row.target.vehicle) for one in plans.values())
    assert vehicles_more["leo"] > vehicles["leo"] + 0.05
    assert vehicles_more["ural"] == vehicles["ural"]  # the only one in its class, whose share is the budget's
    assert sides_more["front"] > 0.3 * 0.1  # part of it keeps the configured distribution


def test_it_is_an_ordinary_plan(plans, tmp_path):
    more = plans["more"]
    assert read_plan(more.path).header.more_of == MISSED
    assert check_plan(more, ASSETS) == []
    again = write_plan(CONFIG, ASSETS, tmp_path / "more.jsonl", workers=2, more_of=MISSED)
    assert again.path.read_bytes().split(b"\n")[1:] == more.path.read_bytes().split(b"\n")[1:]
    poses = {tuple(row.world_from_camera.ravel()) for row in plans["plain"]}
    assert not poses & {tuple(row.world_from_camera.ravel()) for row in more}
    assert b"more_of" not in plans["plain"].path.read_bytes()


@pytest.mark.parametrize("count", [1, 7, 100])
def test_at_least_thirty_percent_of_positions_keep_their_distribution(count):
    alone = kept(np.arange(count))
    assert 0.3 * count <= alone.sum() <= 0.3 * count + 1


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("[]", "a report of"),
        ('{"runs": {}}', "a report of"),
        ('{"overall": {"recall": 1.0}, "picture_px": 9.0, "bins": {}}', "no label was missed"),
        ('{"overall": {"recall": null}, "picture_px": 9.0, "bins": {}}', "no label was missed"),
        ('{"overall": {"recall": 0.5}, "picture_px": 9.0, "bins": {}}', "differs significantly"),
    ],
)
def test_reports_without_weights_are_refused(tmp_path, content, problem):
    path = tmp_path / "report.json"
    path.write_text(content)
    with pytest.raises(ConfigError, match=problem) as caught:
        read_more_of(path)
    assert caught.value.remedy
    with pytest.raises(ConfigError, match="no such file"):
        read_more_of(tmp_path / "missing.json")


def test_the_report_of_an_evaluation_is_accepted(tmp_path, plans):
    """A detector that misses vehicles seen from behind."""
    dataset = Dataset.of_plan(plans["plain"], lambda i: None)
    labels, results = [], []
    for image, row in zip(dataset.images, plans["plain"], strict=True):
        for label in image.labels:
            found = {"image_id": image.id, "category_id": label.record["category_id"], "bbox": label.bbox.tolist()}
            labels.append({**label.record, **found})
            results += [{**found, "score": 0.9}] if side(row) != "rear" else []
    records = [image.record for image in dataset.images]
    write_dataset(tmp_path / "data", records, labels, names=list(dataset.categories.values()), pictures=False)
    (tmp_path / "found.json").write_text(json.dumps(results))
    evaluate_files(tmp_path / "data", tmp_path / "found.json", tmp_path / "report")
    found = read_more_of(tmp_path / "report" / "report.json")
    assert found.weights["azimuth_seen"]["rear"] > 1.5
    assert found.weights["azimuth_seen"]["front"] < 1.0
    assert found.picture_px == pytest.approx(np.sqrt(dataset.images[0].width * dataset.images[0].height))
