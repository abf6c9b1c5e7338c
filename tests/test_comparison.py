"""Datasets compared with photographs: distances, what chance explains, and advice."""

import json
import shutil

import numpy as np
import pytest
import torch
from PIL import Image

from hulldown.assets.photographs import read_photographs
from hulldown.base.errors import DatasetError
from hulldown.cli import main
from hulldown.dataset.reports.comparison import compare, looks, spectral_slope
from hulldown.dataset.reports.coverage import coverage_of
from hulldown.dataset.reports.dataset_report import report
from hulldown.dataset.table import Dataset
from hulldown.tests.editing import write_dataset
from hulldown.tests.networks import nano_weights, small_weights

WIDTH, HEIGHT = 64, 48


def coco(folder, count, *, seed, height=0.3, x=0.5, bright=90):
    """A dataset of one box a picture, with scattered heights and positions."""
    rng = np.random.default_rng(seed)
    (folder / "images").mkdir(parents=True)
    images, labels = [], []
    for i in range(count):
        images.append({"file_name": f"images/{i}.png", "width": WIDTH, "height": HEIGHT})
        h = HEIGHT * height * np.exp(0.1 * rng.standard_normal())
        left = np.clip(WIDTH * (x + 0.05 * rng.standard_normal()) - h / 2, 1, WIDTH - h - 1)
        box = [float(left), float(rng.uniform(5, HEIGHT - 5 - h)), float(h), float(h)]
        labels.append({"image_id": i + 1, "bbox": box})
        noise = rng.normal(bright, 20, (HEIGHT, WIDTH, 3)).clip(0, 255).astype(np.uint8)
        Image.fromarray(noise).save(folder / images[i]["file_name"])
    return write_dataset(folder, images, labels)


def compared(folder, photographs):
    return compare(Dataset.read(folder), read_photographs(photographs), pixels=True)


def test_equal_distributions_are_within_chance(tmp_path):
    one, other = coco(tmp_path / "a", 80, seed=1), coco(tmp_path / "b", 80, seed=2)
    found = compared(one, other)
    assert {each.feature.name for each in found.features} >= {"height", "x", "y", "aspect", "count", "brightness"}
    assert sum(each.differs for each in found.features) <= 1  # chance exceeds the threshold in 5 of 100 cases
    assert all(each.distance < 0.3 for each in found.features)


def test_differences_are_named_with_their_keys(tmp_path):
    own = coco(tmp_path / "a", 60, seed=1, height=0.6, x=0.5, bright=150)
    photographs = coco(tmp_path / "b", 60, seed=2, height=0.2, x=0.7, bright=90)
    found = report(own, tmp_path / "page.html", photographs=photographs)
    text = "\n".join(found.sentences)
    for key in ("camera.target_fraction", "camera.framing", "light.exposure"):
        assert key in text
    assert "camera.truncated_fraction" not in text
    height = next(line for line in found.sentences if "target_fraction" in line)
    assert "too much above" in height
    assert "too little below" in height
    written = found.to_json()
    json.dumps(written, allow_nan=False)
    own_shares = written["features"]["height"]["own"]
    assert sum(own_shares) == pytest.approx(1.0, abs=1e-4)  # each rounded to 1e-6
    assert "Next to the photographs" in (tmp_path / "page.html").read_text()


def test_few_photographs_and_photographs_without_files(tmp_path):
    own = coco(tmp_path / "a", 20, seed=1)
    one = report(own, tmp_path / "page.html", photographs=coco(tmp_path / "one", 1, seed=2, height=0.1))
    assert one.sentences == []
    assert any("four photographs" in note for note in one.notes)
    json.dumps(one.to_json(), allow_nan=False)
    shutil.rmtree(coco(tmp_path / "b", 6, seed=2) / "images")
    boxes = compared(own, tmp_path / "b")
    assert "brightness" not in {each.feature.name for each in boxes.features}
    assert any("pictures" in note for note in boxes.notes)


def test_photographs_without_boxes_are_refused(tmp_path):
    with pytest.raises(DatasetError, match="no boxes"):
        compared(coco(tmp_path / "a", 4, seed=1), coco(tmp_path / "none", 0, seed=1))


@pytest.mark.parametrize("slope", [-1.0, -2.0, -3.0])
def test_the_slope_of_a_spectrum_equals_that_of_its_noise(slope):
    side = 256
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))
    frequency[0, 0] = 1.0
    white = np.fft.rfft2(np.random.default_rng(0).standard_normal((side, side)))
    noise = np.fft.irfft2(white * frequency ** (slope / 2), s=(side, side))
    assert spectral_slope(noise) == pytest.approx(slope, abs=0.15)  # the window mixes neighboring frequencies


def test_appearance_of_an_even_color():
    red = np.zeros((40, 40, 3), dtype=np.uint8)
    red[..., 0] = 255
    found = looks(red)
    np.testing.assert_allclose(found[:4], [0.2126, 0.0, 1.0, 1.0], atol=1e-12)
    assert np.isnan(found[4])


def test_coverage_and_density_of_equal_distributions_have_their_expected_values():
    rng = np.random.default_rng(0)
    images, photographs = rng.standard_normal((600, 4)), rng.standard_normal((400, 4))
    found = coverage_of(images, photographs)
    missed = np.prod([(400 - i) / (1000 - i) for i in range(1, 6)])  # expected value by Naeem et al.
    assert found.coverage == pytest.approx(1.0 - missed, abs=0.02)
    assert found.density == pytest.approx(1.0, abs=0.1)
    assert found.coverage_floor == pytest.approx(1.0 - 0.5**5, abs=0.02)
    assert found.density_floor == pytest.approx(1.0, abs=0.1)


def test_whole_images_are_compared_by_features_of_an_encoder(tmp_path, capsys):
    own, photographs = coco(tmp_path / "a", 30, seed=1), coco(tmp_path / "b", 24, seed=2)
    weights = tmp_path / "nano.pt"
    torch.save(nano_weights(tmp_path), weights)

    def run(photographs, weights):
        command = ["report", own, "-o", tmp_path / "page.html", "--beside", photographs, "--features", weights]
        return main([*map(str, command), "--json"]), *capsys.readouterr()

    code, out, _ = run(photographs, weights)
    found = json.loads(out)
    assert code == 0
    assert 0.3 < found["coverage"]["coverage"] <= 1.0
    assert "Whole images cover" in found["sentences"][0]
    assert "Whole images cover" in (tmp_path / "page.html").read_text()
    apart = json.loads(run(coco(tmp_path / "bright", 24, seed=2, bright=230), weights)[1])
    assert apart["coverage"]["coverage"] < 0.1
    code, out, err = run(coco(tmp_path / "few", 6, seed=2), weights)
    assert json.loads(out)["coverage"] is None
    assert "needs 20 photographs" in err
    torch.save(small_weights(), tmp_path / "small.pt")
    found = [json.loads(run(beside, tmp_path / "small.pt")[1])["coverage"] for beside in (tmp_path / "bright", own)]
    assert found[0]["coverage"] < found[1]["coverage"] == 1.0
    assert main(["report", str(own), "-o", str(tmp_path / "page.html"), "--features", str(weights)]) == 2
    assert "--features needs --beside" in capsys.readouterr().err
