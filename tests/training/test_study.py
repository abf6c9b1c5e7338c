"""`hulldown study`: runs, draws, and a killed study that ends like an undisturbed one."""

import json
import os
import shutil
import signal

import pytest
import tomlkit
from filelock import FileLock
from PIL import Image

from hulldown.base.errors import HulldownError
from hulldown.base.outputs import LOCK_NAME
from hulldown.cli import main
from hulldown.tests.builders.editing import edit
from hulldown.tests.builders.networks import RUN, tiny_weights
from hulldown.tests.builders.training_pictures import make_dataset, make_datasets
from hulldown.tests.training.test_train import CONFIG, in_child, weights
from hulldown.training.inputs.sources import read_classes_and_sources
from hulldown.training.study.config import load_study_config
from hulldown.training.study.study_folder import planned_study_runs, prepare_study, read_study, study_warnings
from hulldown.training.study.train_study import train_study

SMALL = {"model": "small", "resolution": 64, "budget": 24, "batch": 4}  # with the weights of `tiny_weights`
NANO = {"model": "nano", "resolution": 64, "budget": 4, "batch": 1, "weights": "none", "queries": 8, "groups": 1}
FAST = {"name": "fast", "base": "mixed", "train": {"warmup": 0.5}}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return make_datasets(tmp_path_factory.mktemp("pictures"), real=16, synthetic=12, test=8, valid=4)


def written(folder, path, *, train=SMALL, **keys):
    """A study.toml for the pictures."""
    folders = {name: str(folder / name) for name in ("real", "synthetic", "test")}
    default = {"arms": ["real", "mixed"], "fractions": [1.0, 0.5], "seeds": [0]}
    path.write_text(tomlkit.dumps(folders | default | keys | {"train": {"weights": tiny_weights(), **train}}))
    return path


def config_of(folder, path, **keys):
    return load_study_config(written(folder, path / "study.toml", **keys))


def pretend(out, run, found):
    """Write the files of a finished run with detections in test and validation pictures, without training."""
    folder, study = out / "runs" / run.name, read_study(out)
    folder.mkdir(parents=True)
    (folder / "weights.pt").write_bytes(b"")
    sizes = {name: len(read_classes_and_sources({name: path})[1][0]) for name, path in run.data(study, out).items()}
    sources = {name: RUN["sources"]["real"] | {"images": n, "drawn": 12} for name, n in sizes.items()}
    (folder / "run.json").write_text(json.dumps(RUN | {"sources": sources}))
    for which in study.judged_dataset_names:
        (folder / f"{which}.json").write_text(json.dumps(found[which]))


def quiet(what, done, total):
    """No progress."""


def study_in_child(config, out, *, kill_at=None):
    """Run a study on one thread in a separate process, which kills itself at (run's name, what, done)."""

    def progress(what, done, total):
        if kill_at is not None and all(word in what for word in kill_at[:2]) and done == kill_at[2]:
            os.kill(os.getpid(), signal.SIGKILL)

    return in_child(lambda: train_study(config, out, device="cpu", workers=0, progress=progress))


def tree(out):
    """Files that must be equal in two studies: weights and detections."""
    return {
        folder.name: (
            {key: value.numpy().tobytes() for key, value in weights(folder).items()},
            (folder / "test.json").read_bytes(),
        )
        for folder in (out / "runs").iterdir()
    }


@pytest.mark.parametrize(
    ("keys", "kills"),
    [
        ({}, [("mixed-100", "training", 3), ("mixed-50", "looking", 8)]),
        pytest.param(
            {"train": NANO, "fractions": [1.0]}, [("real", "training", 1), ("mixed", "training", 1)], marks=pytest.mark.thorough
        ),
    ],
    ids=["small", "nano"],
)
def test_a_study_killed_twice_ends_like_an_undisturbed_one(pictures, tmp_path, keys, kills):
    study = written(pictures, tmp_path / "study.toml", **keys)
    assert study_in_child(study, tmp_path / "alone") == 0
    for kill in kills:
        assert study_in_child(study, tmp_path / "killed", kill_at=kill) == -signal.SIGKILL
    assert study_in_child(study, tmp_path / "killed") == 0
    assert tree(tmp_path / "alone") == tree(tmp_path / "killed")
    assert len(tree(tmp_path / "alone")) == (4 if not keys else 2)


def drawn(out, name):
    """Names of the photographs that a run can draw."""
    run = next(run for run in planned_study_runs(read_study(out).config) if run.name == name)
    return set(read_classes_and_sources(run.data(read_study(out), out))[1][0].file_names)


def test_seeds_are_complete_and_smaller_fractions_are_subsets_of_larger_ones(pictures, tmp_path):
    keys = {"arms": ["real", "mixed", "balanced", "synthetic"], "fractions": [1.0, 0.5, 0.25], "seeds": [0, 1]}
    study = prepare_study(config_of(pictures, tmp_path, **keys), tmp_path / "out")
    runs = planned_study_runs(study.config)
    shared = [f"{arm}-{share}" for share in (100, 50, 25) for arm in ("real", "mixed", "balanced")]
    assert [run.name for run in runs] == [f"{name}-seed{seed}" for seed in (0, 1) for name in (*shared, "synthetic")]
    few, half, whole = (drawn(tmp_path / "out", f"real-{share}-seed0") for share in (25, 50, 100))
    assert few < half < whole
    assert (len(few), len(whole)) == (4, 16)
    assert drawn(tmp_path / "out", "mixed-25-seed0") == few != drawn(tmp_path / "out", "real-25-seed1")
    assert {run.arm: run.settings.shares for run in runs} == {
        "real": {}, "mixed": {}, "synthetic": {}, "balanced": {"real": 0.5, "synthetic": 0.5},
    }  # fmt: skip


def test_other_data_are_refused_and_other_settings_set_a_run_aside(pictures, tmp_path):
    out = tmp_path / "out"
    prepare_study(config_of(pictures, tmp_path), out)
    changed = make_dataset(tmp_path / "synthetic", 12, seed=9)
    with pytest.raises(HulldownError, match=r"out: the study in this folder has another synthetic; name a new folder"):
        prepare_study(config_of(pictures, tmp_path, synthetic=str(changed)), out)
    other = out / "runs" / "real-100-seed0" / "config.json"
    other.parent.mkdir(parents=True)
    other.write_text(json.dumps(CONFIG))
    config = written(pictures, tmp_path / "study.toml", fractions=[1.0])
    done = train_study(config, out, device="cpu", workers=0, progress=quiet)
    assert (done.finished, list(done.failed)) == (("mixed-100-seed0",), ["real-100-seed0"])
    assert "the run in this folder has" in done.failed["real-100-seed0"]
    other.unlink()
    with FileLock(other.parent / LOCK_NAME):
        assert train_study(config, out, device="cpu", workers=0, progress=quiet).elsewhere == ("real-100-seed0",)
    again = train_study(config, out, device="cpu", workers=0, progress=quiet)
    assert (again.finished, again.already, again.failed) == (("real-100-seed0",), ("mixed-100-seed0",), {})


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"real": "nowhere"}, r"s\.toml: real = 'nowhere': no such folder"),
        ({"arms": ["real", "fake"]}, r"arms\[1\] = 'fake': expected 'real', 'mixed', 'synthetic'"),
        ({"arms": ["real", "real"]}, "arms: real is given twice"),
        ({"arms": [FAST | {"train": {"seed": 3}}]}, r"arms: fast sets train\.seed; one value is for all arms"),
        ({"arms": [FAST | {"train": {"warmup": 7}}]}, "warmup = 7: expected less than 1"),
        ({"arms": [FAST | {"train": {"nothing": 1}}]}, "unknown key nothing"),
        ({"arms": [FAST | {"name": "real"}]}, "arms: real is taken"),
        ({"fractions": [0.0]}, r"fractions\[0\] = 0\.0: expected greater than 0"),
        ({"seeds": []}, "seeds = "),
        ({"sedes": [1]}, "unknown key sedes; did you mean seeds"),
        ({"train": SMALL | {"seed": 3}}, r"train\.seed: the study sets this; set seeds above \[train\]"),
        ({"train": SMALL | {"bugdet": 3}}, r"unknown key train\.bugdet; did you mean train\.budget"),
        ({"train": SMALL | {"model": "tiny"}}, r"train\.model = 'tiny': expected 'small'"),
        ({"valid": ".", "threshold": 0.4}, "threshold: with valid it is chosen there; leave one of the two out"),
    ],
)
def test_the_error_of_a_mistake_in_a_config_names_file_and_key(pictures, tmp_path, keys, words):
    with pytest.raises(HulldownError, match=words):
        load_study_config(written(pictures, tmp_path / "s.toml", **keys))


def test_a_source_without_a_class_is_refused_before_training(pictures, tmp_path):
    other = make_dataset(tmp_path / "other", 8, seed=3, classes=("square", "ring"))
    with pytest.raises(HulldownError, match=r"the classes of synthetic are 'ring', 'square', those of real are 'disc'"):
        prepare_study(config_of(pictures, tmp_path, synthetic=str(other)), tmp_path / "out")
    squares = make_dataset(tmp_path / "squares", 8, seed=3)
    edit(squares, lambda coco: coco.update(annotations=[a for a in coco["annotations"] if a["category_id"] == 1]))
    with pytest.raises(HulldownError, match="synthetic has no box of the class 'disc'"):
        prepare_study(config_of(pictures, tmp_path, synthetic=str(squares)), tmp_path / "out")


@pytest.mark.parametrize("how", ["copied", "saved again", "without contrast"])
def test_a_test_picture_in_the_training_data_is_refused(pictures, tmp_path, how):
    """The second picture has other bytes. The third has no perceptual hash, only its bytes."""
    real, test = shutil.copytree(pictures / "real", tmp_path / "real"), make_dataset(tmp_path / "test", 8, seed=40)
    own, other = real / "images" / "0001.png", test / "images" / "0002.png"
    if how == "without contrast":
        Image.new("RGB", (96, 54), (90, 90, 90)).save(own)
    shutil.copy(own, other)
    if how == "saved again":
        with Image.open(own) as picture:
            picture.convert("P", palette=Image.Palette.ADAPTIVE).save(other)
    with pytest.raises(HulldownError, match=r"images/0002\.png of test shows the same as images/0001\.png of real"):
        prepare_study(config_of(pictures, tmp_path, real=str(real), test=str(test)), tmp_path / "out")


def test_a_folder_with_other_content_is_refused(pictures, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(HulldownError, match=r"out: isn't empty: it has notes\.txt and no study"):
        train_study(written(pictures, tmp_path / "s.toml"), tmp_path / "out", device="cpu", progress=quiet)


def test_init_writes_a_config_that_run_accepts(pictures, tmp_path, capsys):
    words = [f"--{key}={pictures / key}" for key in ("real", "synthetic", "test")]
    assert main(["study", "init", *words, "-o", str(tmp_path / "study.toml")]) == 0
    config = load_study_config(tmp_path / "study.toml")
    assert (len(planned_study_runs(config)), config.train.model, config.train.budget) == (48, "medium", 25_000)
    assert config.real.samefile(pictures / "real")
    capsys.readouterr()
    assert main(["study", "init", *words, "-o", str(tmp_path / "study.toml")]) == 2
    assert "study.toml: exists and isn't" in capsys.readouterr().err
    assert main(["study", "init", *words, f"--valid={pictures / 'valid'}", "-o", str(tmp_path / "with.toml")]) == 0
    assert load_study_config(tmp_path / "with.toml").valid.samefile(pictures / "valid")


def test_a_named_arm_draws_like_its_base_with_other_training(pictures, tmp_path):
    mixed, fast = planned_study_runs(config_of(pictures, tmp_path, arms=["mixed", FAST], fractions=[1.0]))
    assert (mixed.name, fast.name, fast.base) == ("mixed-100-seed0", "fast-100-seed0", "mixed")
    assert (mixed.settings.warmup, fast.settings.warmup) == (0.02, 0.5)
    assert fast.settings.model_copy(update={"warmup": 0.02}) == mixed.settings


def test_a_named_arm_of_another_model_has_that_models_defaults(pictures, tmp_path):
    (tmp_path / "w.pth").write_bytes(b"weights")
    other = {"name": "other", "base": "mixed", "train": {"model": "nano", "weights": "w.pth"}}
    train = {"model": "small", "budget": 24, "batch": 6}
    config = config_of(pictures, tmp_path, arms=["mixed", other], fractions=[1.0], train=train)
    mixed, other = (run.settings for run in planned_study_runs(config))
    assert (mixed.resolution, mixed.batch, mixed.accumulate, mixed.schedule) == (320, 6, 1, "cosine")
    assert (other.resolution, other.batch, other.accumulate, other.schedule) == (384, 6, 4, "step")
    assert mixed.augmentation != other.augmentation
    assert (mixed.weights, other.weights) == (tiny_weights(), str(tmp_path / "w.pth"))


def test_a_study_warns_of_drowned_photographs_and_of_shares_without_a_class(pictures, tmp_path):
    for arms, warns in ((["real", "mixed"], True), (["real", "mixed", "balanced"], False)):
        config = config_of(pictures, tmp_path, arms=arms, fractions=[0.05], seeds=[0, 1])
        warned = study_warnings(prepare_study(config, tmp_path / "out"), tmp_path / "out")
        assert any("add the arm balanced" in line for line in warned) == warns
        assert sum("photographs at 5 % show no" in line for line in warned) == 2
