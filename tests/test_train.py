import hashlib
import json
import os
import signal
import traceback
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torchvision.models import shufflenet_v2_x1_0

from hulldown.base.errors import HulldownError
from hulldown.tests.networks import CLASSES, nano_module, small_weights
from hulldown.tests.training_pictures import make_dataset
from hulldown.training import fit_detr, fit_small
from hulldown.training.detectors import small as small_detector
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.fitting import seed_weights
from hulldown.training.inputs.data import Example
from hulldown.training.inputs.settings import load_settings
from hulldown.training.predict import load_detector, validation_figures
from hulldown.training.train import train

CONFIG = {"settings": {"budget": 47}, "classes": ["square"], "data": {}, "valid": None, "weights_sha256": None}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("pictures") / "set", 24)


def small(**changes):
    base = {"model": "small", "weights": "none", "resolution": 64, "budget": 47, "batch": 4, "accumulate": 2}
    return load_settings(None, base | changes)


def nano(**changes):
    base = {"model": "nano", "resolution": 64, "budget": 24, "batch": 1, "accumulate": 2, "weights": "none"}
    return load_settings(None, base | {"queries": 8, "groups": 1} | changes)


def in_child(run) -> int:
    """Run in a forked process on one thread; return how it ended."""
    pid = os.fork()
    if pid == 0:
        try:
            torch.set_num_threads(1)
            run()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def train_and_die(data, out, settings, at=None, **more):
    def progress(what, done, total):
        if what == "training" and done == at:
            os.kill(os.getpid(), signal.SIGKILL)

    return in_child(
        lambda: train(data, out, settings=settings, device="cpu", checkpoint_every=4, progress=progress, **more)
    )


def weights(run: Path) -> dict:
    return torch.load(run / "weights.pt", weights_only=True)


def rows(path: Path) -> list[list[str]]:
    """The fields of each line of a CSV file after its first."""
    return [line.split(",") for line in path.read_text().splitlines()[1:]]


@pytest.mark.parametrize(
    ("settings", "kills"),
    [
        (small(budget=95), (6, 10)),
        (nano(budget=12), (5,)),
        pytest.param(nano(), (6, 10), marks=pytest.mark.thorough),
    ],
    ids=["small", "nano once", "nano"],
)
def test_a_killed_run_ends_like_an_undisturbed_one(pictures, tmp_path, monkeypatch, settings, kills):
    # No network draws numbers by itself; with a loss that does, each step must be seeded.
    exact = fit_small.center_loss
    monkeypatch.setattr(fit_small, "center_loss", lambda *given: exact(*given) * (1 + torch.rand(())))
    data = {"demo": pictures}
    assert train_and_die(data, tmp_path / "alone", settings, workers=0) == 0
    measured = {"workers": 1, "valid": make_dataset(tmp_path / "valid", 4)}  # which changes no weights
    for at in kills:
        assert train_and_die(data, tmp_path / "killed", settings, at=at, **measured) == -signal.SIGKILL
        assert json.loads((tmp_path / "killed" / "run.json").read_text())["status"] == "running"
    assert train_and_die(data, tmp_path / "killed", settings, **measured) == 0
    alone, killed = weights(tmp_path / "alone"), weights(tmp_path / "killed")
    assert alone["model"].keys() == killed["model"].keys()
    for key, value in alone["model"].items():
        assert torch.equal(value, killed["model"][key]), key
    losses = [[row[:3] for row in rows(tmp_path / name / "metrics.csv")] for name in ("alone", "killed")]
    assert losses[0] == losses[1]
    curve = rows(tmp_path / "killed" / "validation.csv")
    assert len(curve) == (6 if settings.budget == 12 else 10)
    assert int(curve[-1][0]) == len(losses[0])
    run = json.loads((tmp_path / "killed" / "run.json").read_text())
    assert (run["status"], run["steps"]) == ("finished", len(losses[0]))
    assert sum(source["drawn"] for source in run["sources"].values()) == settings.budget
    assert not list((tmp_path / "killed").glob("*.ckpt"))
    detector = load_detector(tmp_path / "killed", "cpu")
    assert detector.classes == ("square", "disc")
    images = [np.zeros((30, 50, 3), dtype=np.uint8), np.zeros((54, 96, 3), dtype=np.uint8)]
    for found, image in zip(detector.detect(images), images, strict=True):
        assert found.xywh.shape == (len(found.score), 4)
        assert (np.diff(found.score) <= 0).all()
        assert set(found.class_index) <= {0, 1}
        corner = found.xywh[:, :2] + found.xywh[:, 2:]
        assert (found.xywh[:, :2] >= -1e-3).all()
        assert (corner <= np.array(image.shape[1::-1]) + 1e-3).all()
    with pytest.raises(HulldownError, match=r"the run in this folder has settings.seed = 0, not 1"):
        train(data, tmp_path / "killed", settings=settings.model_copy(update={"seed": 1}), **measured)


def test_small_starts_from_weights_and_their_classes(tmp_path):
    torch.save(small_weights(), tmp_path / "weights.pt")
    given = weights(tmp_path)["model"]
    for classes in (CLASSES, ("tank", "cube", "truck")):
        made = small_detector.starting_network(classes, tmp_path / "weights.pt").state_dict()
        assert all(torch.equal(made[key], given[key]) for key in given if not key.startswith("heat."))
        for key in ("heat.weight", "heat.bias"):
            for label, row in zip(CLASSES, given[key], strict=True):
                assert torch.equal(made[key][classes.index(label)], row)


def test_training_starts_from_given_weights(pictures, tmp_path):
    torch.save(small_weights(), tmp_path / "weights.pt")
    still = small(weights=str(tmp_path / "weights.pt"), budget=8, learning_rate=1e-9)
    train({"demo": pictures}, tmp_path / "run", settings=still, workers=0, device="cpu")
    given, made = weights(tmp_path)["model"], weights(tmp_path / "run")["model"]
    torch.testing.assert_close(made["head.0.weight"], given["head.0.weight"], rtol=0, atol=1e-7)


@pytest.mark.parametrize("freeze", ["none", "encoder"])
def test_small_starts_from_a_pretrained_backbone_that_can_be_frozen(pictures, tmp_path, freeze):
    torch.manual_seed(1)
    backbone = shufflenet_v2_x1_0().state_dict()
    torch.save(backbone, tmp_path / "weights.pt")
    pretrained = small(weights=str(tmp_path / "weights.pt"), budget=8, freeze=freeze)
    train({"demo": pictures}, tmp_path / "run", settings=pretrained, workers=0, device="cpu")
    made = {key.removeprefix("backbone."): value for key, value in weights(tmp_path / "run")["model"].items()}
    kept = {key for key, value in backbone.items() if key in made and torch.equal(value, made[key])}
    convolutions = {key for key, value in backbone.items() if key in made and value.ndim == 4}
    assert len(convolutions) > 50
    assert kept >= backbone.keys() & made.keys() if freeze == "encoder" else not kept & convolutions
    near = [(backbone[key] - made[key]).abs().max() for key in convolutions]
    assert max(near) < 1e-3  # it started from there, and has a tenth of the learning rate


def test_a_backbone_that_cannot_be_downloaded_is_a_one_line_error(pictures, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr(torch.hub, "download_url_to_file", Mock(side_effect=OSError("no network")))
    with pytest.raises(HulldownError, match=r"\(no network\); put shufflenetv2_x1-.*\.pth into .*hub/checkpoints"):
        train({"demo": pictures}, tmp_path / "run", settings=small(weights=None), workers=0, device="cpu")
    torch.save({"conv1.0.weight": torch.zeros(1)}, tmp_path / "weights.pt")
    with pytest.raises(HulldownError, match=r"weights\.pt: has no backbone of the small model"):
        train({"demo": pictures}, tmp_path / "run", settings=small(weights=str(tmp_path / "weights.pt")), workers=0)
    assert not (tmp_path / "run").exists()


def test_a_finished_run_is_extended(pictures, tmp_path):
    data, run = {"demo": pictures}, tmp_path / "run"
    with pytest.raises(HulldownError, match=r"config\.json: no such file"):
        train(data, run, settings=small(), more_budget=16, workers=0)
    run.mkdir()
    for config, named in (({}, "`settings`"), (CONFIG | {"settings": {"budget": "many"}}, r"\$\.settings\.budget")):
        (run / "config.json").write_text(json.dumps(config))
        with pytest.raises(HulldownError, match=rf"config\.json: isn't the config of a run \(.*{named}"):
            train(data, run, settings=small(), more_budget=16, workers=0)
    (run / "config.json").unlink()
    whole = train(data, tmp_path / "whole", settings=small(budget=47 + 16 + 8), workers=0, device="cpu")
    train(data, run, settings=small(), workers=0, device="cpu")
    before = (run / "weights.pt").read_bytes()
    assert train_and_die(data, run, small(), at=1, more_budget=16, workers=0) == -signal.SIGKILL
    assert train_and_die(data, run, small(), more_budget=16, workers=0) == 0
    assert (run / "before-47" / "weights.pt").read_bytes() == before
    extended = train(data, run, settings=small(), more_budget=8, workers=0, device="cpu")
    assert extended.status == "finished"
    assert (run / "before-63" / "run.json").exists()
    assert whole.budget == 71
    drawn = [row[1:] for name in ("before-47", "before-63", ".") for row in rows(run / name / "draws.csv")]
    assert drawn == [row[1:] for row in rows(tmp_path / "whole" / "draws.csv")]
    before, config = (run / "before-63" / "weights.pt").read_bytes(), json.loads((run / "config.json").read_text())
    assert config["weights_sha256"] == hashlib.sha256(before).hexdigest()


def test_the_best_weights_are_kept_and_figures_logged(pictures, tmp_path):
    data, valid = {"demo": pictures}, make_dataset(tmp_path / "valid", 6)
    good = small(budget=240, batch=6, accumulate=1, learning_rate=8e-3)
    assert train_and_die(data, tmp_path / "good", good, workers=0) == 0
    worse = {"budget": 60, "weights": str(tmp_path / "good" / "weights.pt"), "learning_rate": 0.03, "warmup": 0.5}
    settings = good.model_copy(update={**worse, "keep": "best", "logger": "tensorboard"})
    run = train(data, tmp_path / "run", settings=settings, valid=valid, workers=0, device="cpu")
    curve = rows(tmp_path / "run" / "validation.csv")
    assert run.figures.valid["ap50"] == pytest.approx(max(float(row[2]) for row in curve), abs=1e-5)
    assert run.figures.valid["step"] < run.steps
    again = validation_figures(load_detector(tmp_path / "run", "cpu"), read_labels(valid))
    assert again["ap50"] == pytest.approx(run.figures.valid["ap50"], abs=1e-9)
    logged = EventAccumulator(str(tmp_path / "run" / "tensorboard")).Reload()
    assert len(logged.Scalars("train/loss")) == run.steps
    assert [event.step for event in logged.Scalars("valid/ap50")] == [int(row[0]) for row in curve]
    with pytest.raises(HulldownError, match="--valid"):
        train({"demo": pictures}, tmp_path / "other", settings=settings, workers=0)


@pytest.mark.parametrize("settings", [small, nano], ids=["small", "RF-DETR"])
def test_a_training_that_diverges_names_the_learning_rate(pictures, tmp_path, settings):
    # It ended as finished, with NaN in run.json, which no strict reader of JSON reads, and in its weights.
    wild = settings(budget=95, learning_rate=1.0, weight_decay=100.0)
    for _ in range(2):  # and again, from its checkpoint
        with pytest.raises(HulldownError, match=r"diverged in step \d+; lower learning_rate \(1\)") as error:
            train({"demo": pictures}, tmp_path / "run", settings=wild, workers=0, device="cpu", checkpoint_every=1)
        assert error.value.path == tmp_path / "run"
        assert not (tmp_path / "run" / "weights.pt").exists()
        assert json.loads((tmp_path / "run" / "run.json").read_text(), parse_constant=pytest.fail)["figures"] == {}
        assert np.isfinite([[float(value) for value in row] for row in rows(tmp_path / "run" / "metrics.csv")]).all()


def test_a_frozen_encoder_does_not_change(pictures, tmp_path):
    start = {}
    for freeze in ("none", "encoder"):
        run = tmp_path / freeze
        train({"demo": pictures}, run, settings=nano(budget=4, freeze=freeze), workers=0, device="cpu")
        start[freeze] = {key: value for key, value in weights(run)["model"].items() if ".encoder." in key}
    seed_weights(nano())
    fresh = nano_module(nano(), ("square", "disc"), tmp_path).model.state_dict()
    moved = {name: sum(not torch.equal(state[key], fresh[key]) for key in state) for name, state in start.items()}
    assert len(start["encoder"]) > 50
    assert moved["encoder"] == 0
    assert moved["none"] > 50


def test_rf_detr_gets_boxes_as_centers_and_sizes_in_shares_of_the_picture():
    corners = torch.tensor([[8.0, 10.0, 24.0, 30.0]])
    _, (target,) = fit_detr.collated([Example(torch.zeros(3, 40, 80, dtype=torch.uint8), corners, torch.tensor([1]))])
    torch.testing.assert_close(target["boxes"], torch.tensor([[0.2, 0.5, 0.2, 0.5]]))
    assert (target["labels"].tolist(), target["area"].tolist()) == ([1], [320.0])
