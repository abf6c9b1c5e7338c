import json
import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
from PIL import Image

from hulldown.base.errors import ConfigError, DatasetError, HulldownError
from hulldown.dataset.exports.export import export_dataset
from hulldown.tests.builders.editing import edit
from hulldown.tests.builders.networks import tiny_weights
from hulldown.tests.builders.training_pictures import make_dataset
from hulldown.tests.training.test_augment import TABLE, augmentation
from hulldown.training.inputs.settings import Settings, learning_rate_factor, load_settings
from hulldown.training.inputs.sources import hash_source_pictures, read_classes_and_sources
from hulldown.training.train import train_detector

ROOT = Path(__file__).parents[2]


def sha256(sources):
    return {name: found.sha256 for name, found in hash_source_pictures(sources).items()}


def test_classes_are_matched_by_name_for_any_ids(tmp_path):
    real = make_dataset(tmp_path / "real", 8)
    made = make_dataset(tmp_path / "made", 8)

    def renumber(coco):
        coco["categories"] = [{"id": 40, "name": "disc"}, {"id": 7, "name": "square"}]
        for annotation in coco["annotations"]:
            annotation["category_id"] = {1: 7, 2: 40}[annotation["category_id"]]
            annotation["image_id"] += 99
        for image in coco["images"]:
            image["id"] += 99

    edit(made, renumber)
    classes, (first, second) = read_classes_and_sources({"real": real, "made": made})
    assert classes == ("square", "disc")
    np.testing.assert_array_equal(first.class_index, second.class_index)
    assert read_classes_and_sources({"made": made})[0] == ("square", "disc")
    assert (
        read_classes_and_sources({"made": made}, classes=("disc", "square"))[1][0].class_index.tolist()
        == (1 - first.class_index).tolist()
    )


def test_a_parent_category_without_boxes_is_not_a_class(tmp_path):
    dataset = make_dataset(tmp_path / "set", 4)

    def group(coco):
        coco["categories"] = [
            {"id": 0, "name": "shapes", "supercategory": "none"},
            *({**category, "supercategory": "shapes"} for category in coco["categories"]),
        ]

    edit(dataset, group)
    assert read_classes_and_sources({"real": dataset})[0] == ("square", "disc")
    export_dataset(dataset, tmp_path / "yolo", layout="rfdetr-yolo", fractions=(1.0, 0.0, 0.0))
    assert '0: "square"' in (tmp_path / "yolo/data.yaml").read_text()  # and exports number the same classes
    edit(dataset, lambda coco: coco["annotations"][0].update(category_id=0))
    assert read_classes_and_sources({"real": dataset})[0] == ("shapes", "square", "disc")


def test_a_supercategory_of_an_odd_type_is_no_parent(tmp_path):
    dataset = make_dataset(tmp_path / "set", 4)
    edit(dataset, lambda coco: coco["categories"][0].update(supercategory=["square"]))
    assert read_classes_and_sources({"real": dataset})[0] == ("square", "disc")


def test_pictures_without_boxes_are_used_and_crowds_are_left_out(tmp_path):
    dataset = make_dataset(tmp_path / "set", 8)
    edit(dataset, lambda coco: coco["annotations"][0].update(iscrowd=1))
    _, (source,) = read_classes_and_sources({"real": dataset})
    assert source.boxes_per_image(len(source)).tolist() == [0, 1, 1, 0, 1, 1, 1, 0]
    assert source.read_sample(3).xywh.shape == (0, 4)
    assert source.read_sample(1, masks=True).masks[0].sum() > 0


def test_records_and_pictures_change_the_digest_and_the_order_of_records_does_not(tmp_path):
    dataset = make_dataset(tmp_path / "set", 8)
    _, (before,) = read_classes_and_sources({"real": dataset})
    edit(dataset, lambda coco: (coco["images"].reverse(), coco["annotations"].reverse()))
    _, (after,) = read_classes_and_sources({"real": dataset})
    np.testing.assert_array_equal(before.xywh, after.xywh)
    content = sha256([before])
    assert content == sha256([after])
    Image.new("RGB", (96, 54)).save(dataset / "images/0002.png")
    assert content != sha256([after])
    edit(dataset, lambda coco: coco["annotations"][0]["bbox"].__setitem__(0, 1))
    assert read_classes_and_sources({"real": dataset})[1][0].digest != before.digest


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["annotations"][0].update(bbox=[90, 0, 20, 5]), r"0000\.png: annotation 1 leaves its image by"),
        (lambda c: c["annotations"][0].update(bbox=[9, 0, 0, 5]), "annotation 1 has no area"),
        (lambda c: c["annotations"][0].update(category_id=9), "annotation 1: category 9 does not exist"),
        (lambda c: c["categories"].append({"id": 1, "name": "blob"}), "category 1: its id is given twice"),
        (lambda c: c["annotations"][0].update(image_id=99), "annotation 1: image 99 does not exist"),
        (lambda c: c["images"][0].update(file_name="../x.png"), r"file_name '\.\./x\.png' is no path inside"),
        (
            lambda c: c["annotations"][1].update(segmentation=[[1, 2, 3]]),
            r"0001\.png: annotation 2: segmentation: expected polygons",
        ),
        (lambda c: c.update(images=[], annotations=[]), "has no images; name a dataset that has some"),
    ],
)
def test_a_record_that_training_cannot_use_is_named(tmp_path, change, message):
    dataset = make_dataset(tmp_path / "set", 4)
    edit(dataset, change)
    with pytest.raises(DatasetError, match=message):
        read_classes_and_sources({"real": dataset})


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda path: path.unlink(), r"0002\.png: is missing"),
        (lambda path: path.write_bytes(path.read_bytes()[:-400]), r"0002\.png: cannot be read as a picture"),
        (lambda path: Image.new("RGB", (5, 5)).save(path), r"0002\.png: is 5 x 5 pixels, its record has 96 x 54"),
        ({"budget": 0}, r"budget = 0: expected greater than or equal to 1"),
        ({"model": "nano", "resolution": 100, "weights": "none"}, "resolution = 100: expected a multiple of 32"),
        ({"model": "nano", "weights": "nowhere.pth"}, r"nowhere\.pth: no such run"),
        ({"shares": {"real": 0.5, "made": 0.5}}, r"shares\.made: no source has this name; there are real"),
        ({"augmentation": augmentation(("Sheer", {"p": 1.0}))}, r"augmentation: Albumentations .* has no Sheer"),
        ({"weights": "some.pth"}, "some.pth: no such run"),
    ],
)
def test_a_wrong_picture_or_setting_is_named_before_anything_is_written(tmp_path, mistake, message):
    dataset, settings = make_dataset(tmp_path / "set", 4), {"model": "small", "weights": "none", "budget": 4}
    if isinstance(mistake, dict):
        settings |= mistake
    else:
        mistake(dataset / "images/0002.png")
    with pytest.raises(HulldownError, match=message):
        train_detector({"real": dataset}, tmp_path / "run", settings=settings, device="cpu")
    assert not (tmp_path / "run").exists()


def test_a_folder_with_other_content_is_not_trained_in(tmp_path):
    dataset = make_dataset(tmp_path / "set", 4)
    with pytest.raises(HulldownError, match=r"set: is inside .*set, which this command reads; name a new or an empty folder"):
        train_detector({"real": dataset}, dataset, settings={"model": "small", "weights": "none", "budget": 4}, device="cpu")


def test_a_config_file_is_read_and_its_mistakes_are_named(tmp_path):
    path = tmp_path / "train.toml"
    path.write_text('model = "nano"\nbudget = 100\n[shares]\nreal = 0.5\n')
    settings = load_settings(path, {"budget": 200, "seed": None})
    assert (settings.model, settings.budget, settings.shares) == ("nano", 200, {"real": 0.5})
    assert (settings.batch, settings.accumulate, settings.effective_batch) == (4, 4, 16)
    path.write_text("bugdet = 100\n")
    with pytest.raises(ConfigError, match=r"train\.toml: unknown key bugdet; did you mean budget"):
        load_settings(path, {})
    path.write_text("budget =\n")
    with pytest.raises(ConfigError, match=r"train\.toml: isn't TOML"):
        load_settings(path, {})
    with pytest.raises(ConfigError, match="no such file"):
        load_settings(tmp_path / "none.toml", {})


def test_each_model_has_its_augmentation_and_a_config_names_another(tmp_path):
    assert load_settings(None, {"model": "medium"}).augmentation == TABLE
    own = load_settings(None, {"model": "small"})
    assert own.augmentation != TABLE
    assert Settings.model_validate(own.model_dump()) == own
    assert load_settings(None, {"model": "small", "augmentation": "table1"}).augmentation == TABLE
    path = tmp_path / "train.toml"
    for text, message in (
        ('augmentation = "sideways"', r"sideways: no such file; name an Albumentations file .*, or table1"),
        ('augmentation = "train.toml"', r"train\.toml: isn't an Albumentations file"),
        ("[augmentation]\nflare = { probability = 0.0 }", "lines of a table and presets are gone; name an Albument"),
        ('[augmentation]\npreset = "aerial"', "lines of a table and presets are gone"),
        ("augmentation = 5", "augmentation = 5: "),
    ):
        path.write_text(text)
        with pytest.raises(ConfigError, match=message):
            load_settings(path, {})


def test_the_learning_rate_follows_the_steps_of_the_budget():
    settings = load_settings(None, {"model": "medium"})
    rates = [learning_rate_factor(step, settings, 1000) for step in range(1000)]
    assert rates[0] < 0.1
    assert rates[20:800] == [1.0] * 780
    assert rates[800:] == [0.1] * 200
    cosine = [learning_rate_factor(step, load_settings(None, {"model": "small"}), 1000) for step in range(1000)]
    assert max(cosine) == 1.0
    assert cosine[-1] < 1e-4
    assert all(a >= b for a, b in pairwise(cosine[20:]))


@pytest.mark.thorough
def test_the_error_of_a_failed_download_of_rf_detrs_weights_names_their_place(tmp_path):
    dataset = make_dataset(tmp_path / "set", 4)
    # A proxy that refuses connections stands in for a machine without a network.
    proxies = dict.fromkeys(("HTTP_PROXY", "HTTPS_PROXY"), "http://127.0.0.1:9")
    command = [sys.executable, "-m", "hulldown", "train", "--data", f"a={dataset}", "-o", str(tmp_path / "run")]
    ran = subprocess.run(
        command, env={**os.environ, **proxies, "RF_HOME": str(tmp_path / "home")}, cwd=ROOT, capture_output=True,
        text=True, timeout=300,
    )  # fmt: skip
    last = ran.stderr.strip().splitlines()[-1]
    assert "the pre-trained weights of medium cannot be downloaded" in last
    assert f"put rf-detr-medium.pth into {tmp_path / 'home'}, or give --weights FILE or --weights none" in last
    assert not (tmp_path / "run").exists()


def test_the_error_of_a_verb_without_its_extra_tells_how_to_install_it():
    code = (
        "import importlib.util, sys\n"
        "from hulldown.cli import main\n"
        "find = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name: None if name in ('torch', 'rfdetr') else find(name)\n"
        "sys.exit(main(['train', '--data', 'real=x', '-o', 'run', '--model', 'small']))"
    )
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert ran.returncode == 2
    assert ran.stderr == "hulldown: torch, rfdetr: not installed; pip install 'hulldown[training]'\n"


def test_a_subset_needs_no_extra():
    code = "import sys, hulldown.training.subset; assert not {'torch', 'cv2', 'albumentations'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=120)


def test_run_json_describes_the_run(tmp_path):
    dataset = make_dataset(tmp_path / "set", 8)
    settings = {"model": "small", "weights": tiny_weights(), "resolution": 64, "budget": 9, "batch": 4}
    told = []
    keys = {"settings": settings, "valid": dataset, "workers": 0, "device": "cpu", "say": told.append}
    run = train_detector({"real": dataset, "made": dataset}, tmp_path / "run", **keys)
    assert msgspec.json.decode(msgspec.json.encode(run)) == json.loads((tmp_path / "run" / "run.json").read_text())
    assert (run.status, run.steps, run.effective_batch, run.resolution) == ("finished", 3, 4, (64, 64))
    assert run.sources["real"].drawn + run.sources["made"].drawn == 9
    assert set(valid := run.figures.valid) == {"ap", "ap50", "ap75"}
    table = (tmp_path / "run" / "metrics" / "version_0" / "metrics.csv").read_text().splitlines()
    assert table[0] == "step,train/learning_rate,train/loss,valid/ap,valid/ap50,valid/ap75"
    rows = [[float(n) for n in line.split(",")] for line in table[1:]]
    assert [row[0] for row in rows] == [1, 2, 3]
    assert rows[-1][3:] == pytest.approx([valid[key] for key in valid], abs=1e-5)
    assert train_detector({"real": dataset, "made": dataset}, tmp_path / "run", **keys) == run
    assert told[-1].endswith("is finished already")


def test_the_page_on_training_has_a_row_for_every_key_and_line():
    page = (ROOT / "docs" / "training.md").read_text(encoding="utf-8")
    rows = " ".join(re.findall(r"(?m)^\| (`[^|]+) \|", page))
    assert [name for name in Settings.model_fields if f"`{name}`" not in rows] == []
