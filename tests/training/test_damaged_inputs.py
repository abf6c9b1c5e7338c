"""Damaged or foreign files of the user in a training: a one-line error, and nothing half-written."""

import os
import resource
import signal
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from hulldown.base.errors import ConfigError, DatasetError, HulldownError
from hulldown.cli import main
from hulldown.tests.builders.networks import tiny_weights, write_small_weights
from hulldown.tests.builders.training_pictures import make_dataset
from hulldown.tests.training.test_augment import augmentation
from hulldown.tests.training.test_study import config_of
from hulldown.tests.training.test_train import in_child, nano, small, train_and_die
from hulldown.training.fitting import Recorder
from hulldown.training.inputs.data import DrawnExamples, make_draws
from hulldown.training.inputs.sources import read_classes_and_sources, should_follow_masks
from hulldown.training.predict import load_detector
from hulldown.training.study.study_folder import planned_study_runs, prepare_study
from hulldown.training.train import train_detector


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("pictures") / "set", 8)


SHAPES = {"class_embed.bias": torch.zeros(3), "class_embed.weight": torch.zeros(3, 7)}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"model": {"layer.weight": torch.zeros(3)}}, r"start\.pt: has no weights of RF-DETR"),
        ({"model": SHAPES, "args": {"class_names": ["a", "b"]}}, r"start\.pt: does not fit nano"),
    ],
)
def test_unusable_weights_are_refused_before_the_folder_is_made(pictures, tmp_path, content, words):
    torch.save(content, tmp_path / "start.pt")
    with pytest.raises(HulldownError, match=words):
        train_detector({"demo": pictures}, tmp_path / "run", settings=nano(weights=str(tmp_path / "start.pt")), device="cpu")
    assert not (tmp_path / "run").exists()


@pytest.fixture(scope="module")
def stopped(pictures, tmp_path_factory):
    """A run that was killed after its first checkpoint."""
    run = tmp_path_factory.mktemp("stopped") / "run"
    assert train_and_die({"demo": pictures}, run, small(), at=2, workers=0) == -signal.SIGKILL
    assert (run / "checkpoint.ckpt").exists()
    return run


# Negative steps were accepted, and the others were tracebacks.
ODD_VALUES = [("global_step", -5), ("callbacks", {Recorder.__qualname__: 5}), ("optimizer_states", [5]), ("loops", 5)]


def changed(**values):
    return lambda path: torch.save(torch.load(path, weights_only=True) | values, path)


def of_another_network(path):
    held = torch.load(path, weights_only=True)
    state = {key: value.reshape(-1)[:0] for key, value in held["state_dict"].items()}
    torch.save(held | {"state_dict": state}, path)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
        lambda path: torch.save({"model": {}}, path),
        of_another_network,
        *(changed(**{key: value}) for key, value in ODD_VALUES),
    ],
    ids=["truncated", "of weights", "of another network", *(f"{key} {value}" for key, value in ODD_VALUES)],
)
def test_an_invalid_checkpoint_of_a_run_is_a_one_line_error(pictures, stopped, tmp_path, spoil):
    path = stopped / "checkpoint.ckpt"
    sound = path.read_bytes()
    spoil(path)
    try:
        with pytest.raises(HulldownError, match=r"checkpoint\.ckpt: .*; delete it, and training begins anew"):
            train_detector({"demo": pictures}, stopped, settings=small(), device="cpu", workers=0)
    finally:
        path.write_bytes(sound)


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("model.safetensors", b"\0" * 100),
        ("config.json", b"{"),
        ("config.json", b'{"model_type": "d_fine", "d_model": 30}'),
        ("config.json", b'{"model_type": "bert"}'),
        ("config.json", b'{"model_type": "own", "auto_map": {"AutoConfig": "code.Config"}}'),  # which asks on a terminal
        ("preprocessor_config.json", b"[]"),
        ("preprocessor_config.json", None),
    ],
)
def test_unusable_weights_of_small_are_a_one_line_error(tmp_path, file, content):
    folder = write_small_weights(tmp_path / "weights")
    if content is None:
        (folder / file).unlink()
    else:
        (folder / file).write_bytes(content)
    with pytest.raises(HulldownError, match="weights: cannot be loaded as a detector of transformers") as error:
        load_detector(folder, "cpu")
    assert "\n" not in str(error.value)


def test_weights_that_are_not_numbers_are_refused(tmp_path):
    folder = write_small_weights(tmp_path / "weights")
    state = load_file(folder / "model.safetensors")
    state["model.enc_output.0.weight"][0] = torch.nan
    save_file(state, folder / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(HulldownError, match=r"weights: model\.enc_output\.0\.weight has values that aren't finite"):
        load_detector(folder, "cpu")


@pytest.mark.parametrize("workers", [0, 1])
def test_a_picture_deleted_during_training_is_a_one_line_error(tmp_path, workers):
    dataset = make_dataset(tmp_path / "set", 60)

    def progress(what, done, total):
        if what == "training" and done == 1:
            for path in (dataset / "images").iterdir():
                path.unlink()

    with pytest.raises(DatasetError, match=r"^[^ ]*\.png: is missing; put it there") as caught:
        train_detector(
            {"demo": dataset}, tmp_path / "run", settings=small(budget=400), device="cpu", workers=workers,
            progress=progress,
        )  # fmt: skip
    assert (Path(caught.value.path).suffix, caught.value.problem) == (".png", "is missing")


def test_a_full_disk_is_a_one_line_error_and_leaves_no_weights(pictures, tmp_path, capfd):
    """A limit on file sizes stands in for a full disk: both are errors of writing."""
    run = tmp_path / "run"

    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
        words = ["train", "--data", f"demo={pictures}", "-o", str(run), "--model", "small"]
        words += ["--weights", tiny_weights()]
        os._exit(main([*words, "--budget", "8", "--resolution", "64", "--workers", "0", "--device", "cpu"]))

    assert in_child(limited) == 2
    assert "weights: cannot be written (" in capfd.readouterr().err
    assert not [path.name for path in run.iterdir() if "weights" in path.name or path.name.endswith(".tmp")]


def test_boxes_of_one_run_follow_one_rule(tmp_path):
    """Photographs without masks and renders with masks: no box follows its mask, so that all are equally tight."""
    with_masks = make_dataset(tmp_path / "renders", 4)
    without = make_dataset(tmp_path / "photographs", 4, masks=False)
    _, sources = read_classes_and_sources({"renders": with_masks, "photographs": without})
    assert [source.has_all_masks for source in sources] == [True, False]
    assert should_follow_masks(None, sources[:1])
    rule = should_follow_masks(None, sources)
    assert not rule
    draws = make_draws([4, 4], 12, seed=0)
    examples = DrawnExamples(sources, draws, (96, 54), augmentation(), masks=rule)
    assert not any(examples._sample_of_draw(k).masks for k in range(12))
    with pytest.raises(ConfigError, match="masks = true: photographs has boxes without masks"):
        should_follow_masks(True, sources)


def test_every_arm_of_a_study_follows_the_same_rule(tmp_path):
    for seed, name in enumerate(("real", "synthetic", "test")):
        make_dataset(tmp_path / name, 8, seed=seed, masks=name == "synthetic")
    (tmp_path / "study").mkdir()
    study = prepare_study(config_of(tmp_path, tmp_path, arms=["real", "synthetic"], fractions=[1.0]), tmp_path / "study")
    assert {run.settings.masks for run in planned_study_runs(study.config)} == {False}
