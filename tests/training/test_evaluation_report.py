"""`hulldown evaluate`, from files to files, and its page in a real browser."""

import csv
import json
import shutil

import msgspec
import numpy as np
import pytest
from PIL import Image
from selenium.webdriver.common.by import By

from hulldown.cli import main
from hulldown.tests.builders.detections import dataset, random_case, results
from hulldown.tests.builders.editing import write_dataset
from hulldown.training.evaluation.evaluation_report import evaluate_detections

METRICS = {"tp", "fp", "fn", "precision", "recall", "f1", "mean_iou", "mean_confidence", "ap", "ap50", "ap75"}


def stored(folder, coco, **found):
    """A dataset with its pictures, and files of detections."""
    names = [category["name"] for category in coco["categories"]]
    write_dataset(folder, coco["images"], coco["annotations"], names=names)
    for name, records in found.items():
        (folder / f"{name}.json").write_text(json.dumps(records))
    return folder


def evaluated(dataset, predictions, output, **options):
    """The contents of report.json, which are those of the returned report."""
    found = evaluate_detections(dataset, predictions, output, **options)
    assert json.loads(msgspec.json.encode(found)) == json.loads((output / "report.json").read_text())
    return msgspec.to_builtins(found)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Two positions of three shots, in two sceneries; the far targets are missed."""
    boxes, found = [], []
    for image in range(1, 7):
        for k in range(3):
            near = {"visible_fraction": 1.0, "vehicle": f"v{k}", "distance": 30.0 + 200 * (k == 2)}
            box = (100 * k + 20, 50 * image, 60, 40)
            boxes.append((image, 1 + k % 2, box, near))
            if k < 2:
                found.append((image, 1 + (k % 2 if image != 2 else 0), box, 0.9 - 0.05 * image))
        found.append((image, 1, (500, 20, 50, 50), 0.3 + 0.1 * image))
    coco = dataset(boxes, images=6)
    for k, image in enumerate(coco["images"]):
        image |= {"scenery": "hills" if k < 3 else "steppe", "position": k // 3, "weather": None}
    folder = tmp_path_factory.mktemp("scene")
    better = found + [(image, 1, (220, 50 * image, 60, 40), 0.8) for image in (1, 3, 5)]
    return stored(folder / "data", coco, weak=results(found), better=results(better), none=[])


@pytest.fixture(scope="module")
def weak(scene, tmp_path_factory):
    """The report of the dataset and its detections."""
    output = tmp_path_factory.mktemp("weak") / "report"
    return evaluated(scene, [scene / "weak.json"], output), output


def test_the_report_has_the_documented_keys_and_hand_counted_figures(weak):
    found, output = weak
    assert all(set(one) >= METRICS | {"threshold", "iou"} for one in (found["overall"], *found["per_class"].values()))
    assert (found["threshold"], found["iou"], found["threshold_source"]) == (0.5, 0.5, "given")
    assert (found["images"], found["positions"], found["labels"]) == (6, 2, 18)
    classes = found["per_class"]
    for key, count in (("tp", 11), ("fp", 6), ("fn", 7)):
        assert found["overall"][key] == classes["tank"][key] + classes["truck"][key] == count
    assert found["overall"]["intervals"]["recall"] == [None, None]  # two positions are too few
    rows = [[row[key] for key in ("bin", "labels", "found", "detections")] for row in found["bins"]["distance"]]
    assert rows == [["25 to 50 m", 12, 11, None], ["200 to 400 m", 6, 0, None]]
    assert found["confusion"]["classes"] == ["tank", "truck", "background"]
    assert np.array(found["confusion"]["counts"]).sum() == 11 + 1 + 5 + 6
    with (output / "metrics.csv").open(newline="") as file:
        lines = {row["scope"]: row for row in csv.DictReader(file)}
    assert list(lines) == ["overall", "per_class.tank", "per_class.truck"]
    assert float(lines["overall"]["recall"]) == found["overall"]["recall"]
    assert lines["per_class.truck"]["mean_confidence_fp"] == ""


def labels_shown(path, color=(0, 200, 120)):
    """Pixels of a sheet in the color of labels, or another one."""
    with Image.open(path) as sheet:
        return (abs(np.asarray(sheet).astype(int) - color) < 40).all(axis=2).sum()


def test_sheets_show_misses_and_false_positives(weak):
    assert labels_shown(weak[1] / "misses.png") > 500
    assert labels_shown(weak[1] / "false_alarms.png", (255, 120, 0)) > 500


def test_a_second_report_is_equal_to_the_byte(weak, scene, tmp_path):
    evaluate_detections(scene, [scene / "weak.json"], tmp_path)
    for path in weak[1].iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_the_page_has_figures_bins_and_sheets(weak, browser):
    browser.get((weak[1] / "report.html").as_uri())
    text = browser.find_element(By.TAG_NAME, "main").text
    assert "true positives (TP) 11 " in text
    assert "200 to 400 m 6 0 0.000 (too few positions to tell)" in text
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []
    decoded = """const done = arguments[0], images = [...document.querySelectorAll("main img")];
        Promise.all(images.map((i) => i.decode())).then(() => done(images.length), (error) => done(String(error)));"""
    assert browser.execute_async_script(decoded) == 2 + 2  # charts and sheets


def test_detectors_are_compared_with_the_first(scene, tmp_path, browser):
    shutil.copy(scene / "weak.json", tmp_path / "twin #2.json")
    found = evaluated(scene, [scene / "weak.json", scene / "better.json", tmp_path / "twin #2.json"], tmp_path / "r")
    better, twin = found["comparisons"]
    assert (better["first"], better["second"]) == ("weak", "better")
    assert better["difference"]["recall"] == pytest.approx(3 / 18, abs=1e-5)
    assert better["intervals"]["recall"] == [None, None]
    assert {value for value in twin["difference"].values() if value is not None} == {0.0}
    with (tmp_path / "r" / "metrics.csv").open(newline="") as file:
        assert [row["predictions"] for row in csv.DictReader(file)] == ["weak"] * 3 + ["better"] * 3 + ["twin #2"] * 3
    browser.get((tmp_path / "r" / "report.html").as_uri())
    browser.find_element(By.LINK_TEXT, "twin #2").click()
    assert browser.title.startswith("twin #2 on")


def test_files_with_equal_names_are_named_by_their_folders(scene, tmp_path):
    for run in ("a", "b"):
        (tmp_path / run).mkdir()
        shutil.copy(scene / "none.json", tmp_path / run / "predictions.json")
    paths = [tmp_path / run / "predictions.json" for run in ("a", "b")]
    assert set(evaluated(scene, paths, tmp_path / "r")["runs"]) == {"a", "b"}


def test_without_detections_labels_or_images_there_is_a_report(scene, tmp_path):
    found = evaluated(scene, [scene / "none.json"], tmp_path / "r")
    for one in (found["overall"], *found["per_class"].values()):
        assert [one[key] for key in ("recall", "f1", "ap", "precision")] == [0, 0, 0, None]
    folder = stored(tmp_path / "alarm", dataset([]), found=results([(1, 1, (0, 0, 9, 9), 0.9)]))
    found = evaluated(folder, [folder / "found.json"], tmp_path / "r")
    assert (found["overall"]["fp"], found["overall"]["recall"], found["overall"]["ap"]) == (1, None, None)
    folder = stored(tmp_path / "nothing", dataset([], images=0), found=[])
    found = evaluated(folder, [folder / "found.json"], tmp_path / "r")
    assert (found["images"], found["overall"]["ap"]) == (0, None)


def test_a_perfect_detector_has_1_and_0_everywhere(tmp_path):
    coco, _ = random_case(3, crowds=0.0)
    # Labels far apart, since either of two overlapping ones could match.
    for k, box in enumerate(coco["annotations"]):
        box["bbox"] = [100.0 * k, 0.0, 50.0, 40.0]
    found = results([(a["image_id"], a["category_id"], a["bbox"], 1.0) for a in coco["annotations"]])
    folder = stored(tmp_path / "d", coco, found=found)
    got = evaluated(folder, [folder / "found.json"], tmp_path / "r")
    for one in (got["overall"], *got["per_class"].values()):
        assert {one[key] for key in ("precision", "recall", "f1", "mean_iou", "mean_confidence")} == {1}
        assert {one[key] for key in ("ap", "ap50", "ap75")} == {1}
        assert {one[key] for key in ("fp", "fn")} == {0}
        assert one["intervals"]["recall"][1] == one["intervals"]["ap50"][1] == 1
        assert 0.5 < one["intervals"]["recall"][0] < 0.9


def test_missing_pictures_do_not_change_figures(scene, weak, tmp_path):
    (tmp_path / "d").mkdir()
    shutil.copy(scene / "annotations.json", tmp_path / "d")
    found = evaluated(tmp_path / "d", [scene / "weak.json"], tmp_path / "r")
    assert found["overall"] == weak[0]["overall"]
    assert labels_shown(weak[1] / "misses.png") > 500
    assert labels_shown(tmp_path / "r" / "misses.png") == 0  # captions name the missing ones


def test_the_threshold_can_come_from_a_validation_set(scene, tmp_path):
    boxes = [(1, 1, (x, 0, 9, 9)) for x in (0, 50, 100)]
    found = [(1, 1, (x, 0, 9, 9), score) for x, score in ((0, 0.8), (50, 0.7), (200, 0.6), (300, 0.6), (100, 0.5))]
    valid = stored(tmp_path / "valid", dataset(boxes), found=results(found))
    got = evaluated(scene, [scene / "weak.json"], tmp_path / "r", validation=[valid, valid / "found.json"])
    assert (got["threshold"], got["threshold_source"]) == (0.7, "validation")


def test_the_command_writes_and_prints_the_report(scene, tmp_path, capsys):
    words = ["evaluate", str(scene), str(scene / "weak.json"), "-o", str(tmp_path / "r"), "--json"]
    assert main([*words, "--threshold", "0.65", "--iou", "0.75"]) == 0
    answer = capsys.readouterr()
    found = json.loads(answer.out)
    assert (found["threshold"], found["iou"]) == (0.65, 0.75)
    assert "weak: precision" in answer.err
    assert (tmp_path / "r" / "report.html").exists()


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("nowhere.json", (), "nowhere.json: no such file"),
        ("annotations.json", (), "detection 0: score is None"),
        ("weak.json", ("--validation", ".", "none.json"), "has nothing to choose a threshold from; give one with --th"),
        ("weak.json", ("--validation", "."), "names 0 files of detections where 1 are evaluated"),
    ],
)
def test_a_mistake_is_a_one_line_error_and_leaves_nothing(scene, tmp_path, monkeypatch, capsys, name, options, words):
    monkeypatch.chdir(scene)
    assert main(["evaluate", ".", name, *options, "-o", str(tmp_path / "r")]) == 2
    printed = capsys.readouterr().err
    assert words in printed
    assert printed.count("\n") == 1
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("words", [["--threshold", "2"], ["--iou", "0"], ["--threshold", "best"]])
def test_a_number_out_of_range_is_refused(words, capsys):
    assert main(["evaluate", "d", "p", "-o", "r", *words]) == 2
    assert f"for {words[0]}" in capsys.readouterr().err
