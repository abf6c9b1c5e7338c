import json
import os
import signal
import traceback
from pathlib import Path

import huggingface_hub.constants
import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from transformers import DetrConfig, DetrForObjectDetection, DetrImageProcessor, ResNetConfig

from hulldown.base.errors import HulldownError
from hulldown.tests.builders.editing import edit
from hulldown.tests.builders.networks import RUN, tiny_weights, write_small_weights
from hulldown.tests.builders.training_pictures import make_dataset
from hulldown.tests.training.test_augment import augmentation
from hulldown.training import fit_detr, fit_transformers
from hulldown.training.detectors.transformers_detector import starting_network_and_processor
from hulldown.training.evaluation.labels import read_labels
from hulldown.training.inputs.data import Example
from hulldown.training.inputs.settings import load_settings
from hulldown.training.predict import load_detector, predict_detections, validation_aps
from hulldown.training.train import train_detector

CONFIG = {"settings": {"budget": 47}, "classes": ["square"], "data": {}, "valid": None, "weights_sha256": None}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("pictures") / "set", 24)


def small(**changes):
    base = {"model": "small", "weights": tiny_weights(), "resolution": 64, "budget": 47, "batch": 4, "accumulate": 2}
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
        lambda: train_detector(data, out, settings=settings, device="cpu", checkpoint_every_s=0.0, progress=progress, **more)
    )


def weights(run: Path) -> dict:
    folder = run / "weights"
    return load_file(folder / "model.safetensors") if folder.exists() else torch.load(run / "weights.pt")["model"]


def metrics(run: Path) -> list[dict[str, float]]:
    """The rows of a run's tables, over all of its starts."""
    rows = []
    for path in sorted((run / "metrics").glob("version_*/metrics.csv")):
        keys, *lines = (line.split(",") for line in path.read_text().splitlines())
        rows += [{key: float(value) for key, value in zip(keys, line, strict=True) if value} for line in lines]
    return rows


@pytest.mark.parametrize(
    ("settings", "kills"),
    [(small(budget=95), (6, 10)), (nano(budget=12), (5,)), pytest.param(nano(), (6, 10), marks=pytest.mark.thorough)],
    ids=["small", "nano once", "nano"],
)
def test_a_killed_run_continues_from_its_checkpoint(pictures, tmp_path, settings, kills):
    data, out, steps = {"demo": pictures}, tmp_path / "run", settings.steps
    measured = {"workers": 1, "valid": make_dataset(tmp_path / "valid", 4)}
    for at in kills:
        assert train_and_die(data, out, settings, at=at, **measured) == -signal.SIGKILL
        assert json.loads((out / "run.json").read_text())["status"] == "running"
        checkpoint = torch.load(out / "checkpoint.ckpt", weights_only=True)
        assert checkpoint["global_step"] == at - 1
    told = []

    def progress(what, done, total):
        told.append((what, done, total))

    run = train_detector(data, out, settings=settings, device="cpu", progress=progress, **measured)
    resumed = [(done, total) for what, done, total in told if what == "training"]
    assert resumed == [(step, steps) for step in range(kills[-1], steps + 1)]
    assert (run.status, run.steps) == ("finished", steps)
    assert sum(source.drawn for source in run.sources.values()) == settings.budget
    logged = [row for row in metrics(out) if "train/learning_rate" in row]
    assert logged[-1]["step"] == steps
    assert {"train/loss", "valid/ap", "valid/ap50", "valid/ap75"} <= logged[-1].keys()
    assert not list(out.glob("*.ckpt"))
    if settings.model == "small":
        train_detector(data, tmp_path / "whole", settings=settings, device="cpu", workers=1)
        for key, value in weights(tmp_path / "whole").items():
            assert torch.equal(value, weights(out)[key]), key
    detector = load_detector(out, "cpu")
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
        train_detector(data, out, settings=settings.model_copy(update={"seed": 1}), **measured)


def test_a_run_that_is_killed_after_its_last_step_keeps_its_averaged_weights(pictures, tmp_path, monkeypatch):
    data, out, settings = {"demo": pictures}, tmp_path / "run", small(budget=16, learning_rate=0.01)
    with monkeypatch.context() as patch:
        patch.setattr(fit_transformers, "save_transformers_weights", lambda *_: os.kill(os.getpid(), signal.SIGKILL))
        assert train_and_die(data, out, settings, workers=0) == -signal.SIGKILL
    checkpoint = torch.load(out / "checkpoint.ckpt", weights_only=True)
    average = checkpoint["callbacks"]["RFDETREMACallback"]["average_model_state_dict"]
    run = train_detector(data, out, settings=settings, workers=0, device="cpu")
    assert (run.status, run.figures.final_loss) == ("finished", None)
    same = {key: value for key, value in weights(out).items() if f"module.model.{key}" in average}  # others are renamed
    assert len(same) > 100
    assert all(torch.equal(value, average[f"module.model.{key}"]) for key, value in same.items())
    assert any(not torch.equal(value, checkpoint["state_dict"][f"model.{key}"]) for key, value in same.items())


def test_small_starts_from_weights_and_trains_its_backbone(pictures, tmp_path):
    settings = small(budget=8, learning_rate=1e-5)
    train_detector({"demo": pictures}, tmp_path / "run", settings=settings, workers=0, device="cpu")
    given, made = load_file(Path(tiny_weights()) / "model.safetensors"), weights(tmp_path / "run")
    moved = {key for key in given if not torch.equal(given[key], made[key])}
    assert {key for key in moved if "encoder" in key}
    assert any(".backbone." in key for key in moved)
    assert all((given[key] - made[key]).abs().max() < 1e-3 for key in given if key.endswith("weight"))


def test_small_can_memorize_a_few_pictures(tmp_path):
    pictures = make_dataset(tmp_path / "set", 8)
    keys = {"resolution": 96, "budget": 1200, "batch": 8, "accumulate": 1, "learning_rate": 2e-3}
    settings = small(augmentation=augmentation(), **keys)
    run = train_detector({"demo": pictures}, tmp_path / "run", settings=settings, valid=pictures, workers=0, device="cpu")
    assert run.figures.valid["ap50"] > 0.5  # of random weights: 0.00
    losses = [row["train/loss"] for row in metrics(tmp_path / "run")]
    assert np.mean(losses[-5:]) < np.mean(losses[:5]) / 1.5


def test_new_classes_start_from_those_of_their_name_in_a_run_or_from_truck(tmp_path):
    write_small_weights(tmp_path / "before" / "weights", classes=("tank", "cube", "truck"))
    (tmp_path / "before" / "run.json").write_text(json.dumps(RUN))
    network, _ = starting_network_and_processor(small(weights=str(tmp_path / "before")), ("howitzer", "tank"))
    assert network.config.id2label == {0: "howitzer", 1: "tank"}
    before = load_detector(tmp_path / "before", "cpu").network.state_dict()
    for key, value in network.state_dict().items():
        given = before[key]
        rows = [2, 0, 3] if given.shape[:1] == (4,) else [2, 0]
        assert torch.equal(value, given if value.shape == given.shape else given[rows]), key
    assert network.state_dict()["class_embed.0.weight"].shape == (2, 32)


def test_another_detector_of_transformers_trains_too(pictures, tmp_path):
    """DETR has a class for nothing, normalized pictures, and one query embedding for each object."""
    backbone = ResNetConfig(
        embedding_size=8, hidden_sizes=[8, 16, 16, 32], depths=[1, 1, 1, 1], out_features=["stage4"]
    )  # fmt: skip
    config = DetrConfig(
        backbone_config=backbone, use_timm_backbone=False, d_model=32, encoder_layers=1, decoder_layers=1,
        encoder_ffn_dim=32, decoder_ffn_dim=32, encoder_attention_heads=2, decoder_attention_heads=2, num_queries=10,
        id2label={0: "truck", 1: "N/A", 2: "N/A", 3: "car"}, label2id={"truck": 0, "car": 3},
    )  # fmt: skip
    DetrForObjectDetection(config).save_pretrained(tmp_path / "start")
    DetrImageProcessor().save_pretrained(tmp_path / "start")
    settings = small(weights=str(tmp_path / "start"), budget=8, queries=5)
    run = train_detector({"demo": pictures}, tmp_path / "run", settings=settings, workers=0, device="cpu")
    assert 0.0 < run.figures.final_loss < 100.0
    detector = load_detector(tmp_path / "run", "cpu")
    (found,) = detector.detect([np.zeros((54, 96, 3), dtype=np.uint8)])
    assert detector.classes == ("square", "disc")
    assert len(found.score) == 5


def test_d_fine_nano_has_its_published_size():
    network, processor = starting_network_and_processor(small(weights="none", resolution=160), ("tank",))
    assert 3.6e6 < sum(parameter.numel() for parameter in network.parameters()) < 3.9e6
    assert network.config.num_queries == 10 * 10 + 5 * 5  # a cell of each stride has one
    assert not processor.do_normalize


def test_a_hub_without_network_and_other_weights_are_one_line_errors(pictures, tmp_path, monkeypatch):
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
    (tmp_path / "empty").mkdir()
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "model.safetensors").write_bytes(b"nothing")
    for named, words in (
        (None, "ustc-community/dfine-nano-coco: cannot be loaded"),
        ("someone/some-detector", "someone/some-detector: cannot be loaded .*; name a run"),
        (str(tmp_path / "empty"), r"is a folder, not a run"),
        (str(tmp_path / "half"), "half: cannot be loaded"),
    ):
        with pytest.raises(HulldownError, match=words) as error:
            train_detector({"demo": pictures}, tmp_path / "run", settings=small(weights=named), workers=0, device="cpu")
        assert "\n" not in str(error.value)
    assert not (tmp_path / "run").exists()


def test_the_best_weights_are_kept_and_figures_logged(pictures, tmp_path):
    """Labels are what the starting weights find, so that training makes them worse."""
    valid = make_dataset(tmp_path / "valid", 6)
    torch.manual_seed(0)
    start = write_small_weights(tmp_path / "start", classes=("square", "disc"))
    predict_detections(start, valid, tmp_path / "found.json", device="cpu")
    found = [one for one in json.loads((tmp_path / "found.json").read_text()) if one["score"] > 0.5]
    assert len(found) > 5
    labels = [one | {"id": k, "iscrowd": 0, "area": 1.0} for k, one in enumerate(found, 1)]
    edit(valid, lambda coco: coco.update(annotations=labels))
    keys = {"budget": 80, "accumulate": 1, "learning_rate": 0.03, "warmup": 0.9, "logger": "tensorboard"}
    settings = small(weights=str(start), keep="best", **keys)
    run = train_detector({"demo": pictures}, tmp_path / "run", settings=settings, valid=valid, workers=0, device="cpu")
    curve = [row for row in metrics(tmp_path / "run") if "valid/ap50" in row]
    assert len(curve) == 10
    best = max(curve, key=lambda row: row["valid/ap50"])
    assert run.figures.valid["ap50"] == pytest.approx(best["valid/ap50"], abs=1e-9)
    assert run.figures.valid["step"] == best["step"] < run.steps
    again = validation_aps(load_detector(tmp_path / "run", "cpu"), read_labels(valid))
    assert again["ap50"] == pytest.approx(run.figures.valid["ap50"], abs=1e-9)
    logged = EventAccumulator(str(tmp_path / "run" / "tensorboard")).Reload()
    assert len(logged.Scalars("train/loss")) == run.steps
    assert [event.step for event in logged.Scalars("valid/ap50")] == [int(row["step"]) for row in curve]
    with pytest.raises(HulldownError, match="--valid"):
        train_detector({"demo": pictures}, tmp_path / "other", settings=settings, workers=0)


@pytest.mark.parametrize("settings", [small, nano], ids=["small", "RF-DETR"])
def test_a_training_that_diverges_names_the_learning_rate(pictures, tmp_path, settings):
    # It ended as finished, with NaN in run.json, which no strict reader of JSON reads, and in its weights.
    wild = settings(budget=95, learning_rate=1.0, weight_decay=100.0)
    for _ in range(2):  # and again, from its checkpoint
        with pytest.raises(HulldownError, match=r"diverged in step \d+; lower learning_rate \(1\)") as error:
            train_detector({"demo": pictures}, tmp_path / "run", settings=wild, workers=0, device="cpu", checkpoint_every_s=0.0)
        assert error.value.path == tmp_path / "run"
        assert not list((tmp_path / "run").glob("weights*"))
        assert json.loads((tmp_path / "run" / "run.json").read_text(), parse_constant=pytest.fail)["figures"] == {}


def test_rf_detr_gets_boxes_as_centers_and_sizes_in_shares_of_the_picture():
    corners = torch.tensor([[8.0, 10.0, 24.0, 30.0]])
    _, (target,) = fit_detr.collate_detr_examples(
        [Example(torch.zeros(3, 40, 80, dtype=torch.uint8), corners, torch.tensor([1]))]
    )
    torch.testing.assert_close(target["boxes"], torch.tensor([[0.2, 0.5, 0.2, 0.5]]))
    assert (target["labels"].tolist(), target["area"].tolist()) == ([1], [320.0])
