"""`hulldown study`: runs, draws, and a killed study that ends like an undisturbed one."""

import json
import os
import shutil
import signal
from contextlib import closing

import numpy as np
import pytest
import tomlkit
from filelock import FileLock
from PIL import Image

from hulldown.base.errors import HulldownError
from hulldown.cli import main
from hulldown.tests.editing import edit
from hulldown.tests.networks import RUN, tiny_weights
from hulldown.tests.test_train import CONFIG, in_child, weights
from hulldown.tests.training_pictures import make_dataset, make_datasets
from hulldown.training.run_folder import LOCK_NAME, RunFolder
from hulldown.training.study.arms import ARM_KINDS, arm_draws
from hulldown.training.study.config import load_study
from hulldown.training.study.manifest import predictions_paths, read_manifest, settle, study_runs
from hulldown.training.study.run_process import run_one
from hulldown.training.study.runs import RunOptions, in_processes, read_failures, run_study

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


def settled(folder, path, **keys):
    return settle(load_study(written(folder, path / "study.toml", **keys)))


def here(study, names, options, progress):
    """Runs in this process."""
    for number, name in enumerate(names, 1):
        reason = None
        try:
            run_one(study, name, options, lambda what, *done, at=f"{name} ({number})": progress(f"{at}: {what}", *done))
        except HulldownError as error:
            reason = str(error)
        yield name, reason


def pretend(study, out, name, found=None):
    """Write the files of a finished run with detections in test and validation pictures, without training."""
    run = study.run(name)
    folder = out / "runs" / run.folder
    folder.mkdir(parents=True)
    (folder / "weights.pt").write_bytes(b"")
    (folder / "run.json").write_text(json.dumps(RUN))
    for which, path in predictions_paths(out, study, run).items():
        path.write_text(json.dumps(found[which] if found else []))


def study_in_child(study, out, *, kill_at=None):
    """Run a study on one thread in a separate process, which kills itself at (run's name, what, done)."""

    def progress(what, done, total):
        if kill_at is not None and all(word in what for word in kill_at[:2]) and done == kill_at[2]:
            os.kill(os.getpid(), signal.SIGKILL)

    return in_child(lambda: run_study(study, out, options=RunOptions("cpu", 0), launch=here, progress=progress))


def tree(out):
    """Files that must be equal in two studies: weights, draws, detections."""
    manifest = read_manifest(out)
    found = {}
    for run in manifest.runs:
        folder = out / "runs" / run.folder
        found[run.name] = (
            {key: value.numpy().tobytes() for key, value in weights(folder).items()},
            manifest.draws(run).digest,
            [path.read_bytes() for path in sorted(folder.glob("test-*.json")) if ".info" not in path.name],
        )
    return found


@pytest.mark.parametrize(
    ("keys", "kills"),
    [
        ({}, [("mixed-100", "training", 3), ("mixed-50", "looking", 8)]),
        pytest.param(
            {"train": NANO, "fractions": [1.0]},
            [("real", "training", 1), ("mixed", "training", 1)],
            marks=pytest.mark.thorough,
        ),
    ],
    ids=["small", "nano"],
)
def test_a_study_killed_twice_ends_like_an_undisturbed_one(pictures, tmp_path, keys, kills):
    study = settled(pictures, tmp_path, **keys)
    assert study_in_child(study, tmp_path / "alone") == 0
    for kill in kills:
        assert study_in_child(study, tmp_path / "killed", kill_at=kill) == -signal.SIGKILL
    assert study_in_child(study, tmp_path / "killed") == 0
    assert tree(tmp_path / "alone") == tree(tmp_path / "killed")
    assert len(tree(tmp_path / "alone")) == (4 if not keys else 2)


@pytest.mark.parametrize("arm", ARM_KINDS)
def test_draws_add_up_to_the_budget(arm):
    photographs, budget = np.array([2, 3, 7]), 600
    draws = arm_draws(arm, photographs, 9, budget=budget, seed=1)
    assert len(draws) == 600
    by_source = {name: draws.image[draws.source == k] for k, name in enumerate(ARM_KINDS[arm].sources)}
    assert sum(map(len, by_source.values())) == len(draws)
    if "real" in by_source:
        assert set(by_source["real"].tolist()) == {2, 3, 7}
    if "synthetic" in by_source:
        assert set(by_source["synthetic"].tolist()) == set(range(9))
    share = {"real": 1.0, "mixed": 0.25, "balanced": 0.5}.get(arm, 0.0)
    assert len(by_source.get("real", ())) / len(draws) == pytest.approx(share, abs=0.05)


def test_seeds_are_complete_and_smaller_fractions_are_subsets_of_larger_ones(pictures, tmp_path):
    keys = {"arms": ["real", "mixed", "synthetic"], "fractions": [1.0, 0.5, 0.25], "seeds": [0, 1]}
    study = settled(pictures, tmp_path, train=SMALL | {"budget": 600}, **keys)  # so that every picture is drawn
    runs = study.runs
    shared = [f"{arm}-{share}" for share in (100, 50, 25) for arm in ("real", "mixed")]
    assert [run.name for run in runs] == [f"{name}-seed{seed}" for seed in (0, 1) for name in (*shared, "synthetic")]
    drawn = {}
    for run in runs:
        draws = study.draws(run)
        drawn[run.name] = set(draws.image[draws.source == 0].tolist()) if "real" in run.sources else set()
        assert sum(run.drawn.values()) == len(draws) == run.settings.budget
    for seed in (0, 1):
        few, half, whole = (drawn[f"real-{share}-seed{seed}"] for share in (25, 50, 100))
        assert few < half < whole
        assert drawn[f"mixed-25-seed{seed}"] <= few
    assert drawn["real-25-seed0"] != drawn["real-25-seed1"]


def test_a_runs_folder_is_named_by_all_its_inputs(pictures, tmp_path):
    def folders(**keys):
        return {run.name: run.folder for run in settled(pictures, tmp_path, **keys).runs}

    before = folders()
    assert before == folders(iou=0.6)
    assert not {*folders(train=SMALL | {"learning_rate": 0.001}).values()} & {*before.values()}
    changed = make_dataset(tmp_path / "synthetic", 12, seed=9)
    differing = {name for name, folder in folders(synthetic=str(changed)).items() if folder != before[name]}
    assert differing == {"mixed-100-seed0", "mixed-50-seed0"}


def refuse(out, run):
    """Put another run's config into a run's folder, so that it fails."""
    other = out / "runs" / run.folder / "config.json"
    other.parent.mkdir(parents=True)
    other.write_text(json.dumps(CONFIG))
    (out / "study.json").touch()


def test_a_failed_run_is_set_aside_and_the_others_continue(pictures, tmp_path):
    study, out, options = settled(pictures, tmp_path, fractions=[1.0]), tmp_path / "out", RunOptions("cpu", 0)
    real, mixed = study.runs
    refuse(out, real)
    done = run_study(study, out, options=options, launch=here)
    assert (done.finished, list(done.failed)) == ((mixed.name,), [real.name])
    assert "the run in this folder has" in done.failed[real.name]
    assert read_failures(out) == done.failed
    (out / "runs" / real.folder / "config.json").unlink()
    again = run_study(study, out, options=options, launch=here)
    assert (again.finished, again.already, again.failed) == ((real.name,), (mixed.name,), {})
    assert read_failures(out) == {}


def test_two_slots_run_two_runs_at_once_and_the_end_stops_what_runs(pictures, tmp_path):
    study, out = settled(pictures, tmp_path, fractions=[1.0], train=SMALL | {"budget": 40_000}), tmp_path / "out"
    (real, mixed), options = study.runs, RunOptions("cpu", 0)
    refuse(out, mixed)

    def launch(study, names, options, progress):
        with closing(in_processes(study, names, [options, options], progress)) as ended:
            yield next(ended)  # the second run; in sequence, the first would end first

    done = run_study(study, out, options=options, launch=launch)
    assert (done.finished, list(done.failed)) == ((), [mixed.name])
    folder = RunFolder(out / "runs" / real.folder)
    folder.path.mkdir(exist_ok=True)
    with FileLock(folder.path / LOCK_NAME, timeout=60):
        assert folder.finished() is None


def test_a_run_in_a_separate_process_finishes_or_fails_with_its_reason(pictures, tmp_path):
    study = settled(pictures, tmp_path, fractions=[1.0])
    real, mixed = study.runs
    refuse(tmp_path / "out", mixed)
    steps = []
    # With a loader process, since a forked process must not wait for a lock of its parent.
    done = run_study(study, tmp_path / "out", options=RunOptions("cpu", 1), progress=lambda *told: steps.append(told))
    assert done.finished == (real.name,)
    assert (f"{real.name} (1 of 2): training", 6, 6) in steps
    assert (f"{real.name} (1 of 2): looking at test", 8, 8) in steps
    assert "the run in this folder has" in done.failed[mixed.name]


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
        load_study(written(pictures, tmp_path / "s.toml", **keys))


def test_a_source_without_a_class_is_refused_before_training(pictures, tmp_path):
    other = make_dataset(tmp_path / "other", 8, seed=3, classes=("square", "ring"))
    with pytest.raises(HulldownError, match=r"the classes of synthetic are 'ring', 'square', those of real are 'disc'"):
        settled(pictures, tmp_path, synthetic=str(other))
    squares = make_dataset(tmp_path / "squares", 8, seed=3)
    edit(squares, lambda coco: coco.update(annotations=[a for a in coco["annotations"] if a["category_id"] == 1]))
    with pytest.raises(HulldownError, match="synthetic has no box of the class 'disc'"):
        settled(pictures, tmp_path, synthetic=str(squares))


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
        settled(pictures, tmp_path, real=str(real), test=str(test))


def test_a_folder_with_other_content_is_refused(pictures, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(HulldownError, match=r"out: holds notes\.txt and no study"):
        run_study(settled(pictures, tmp_path), tmp_path / "out", options=RunOptions("cpu"))


def test_init_writes_a_config_that_run_accepts(pictures, tmp_path, capsys):
    words = [f"--{key}={pictures / key}" for key in ("real", "synthetic", "test")]
    assert main(["study", "init", *words, "-o", str(tmp_path / "study.toml")]) == 0
    config = load_study(tmp_path / "study.toml")
    assert (len(study_runs(config)), config.train.model, config.train.budget) == (48, "medium", 25_000)
    assert config.real.samefile(pictures / "real")
    capsys.readouterr()
    assert main(["study", "init", *words, "-o", str(tmp_path / "study.toml")]) == 2
    assert "study.toml: is there already" in capsys.readouterr().err
    assert main(["study", "init", *words, f"--valid={pictures / 'valid'}", "-o", str(tmp_path / "with.toml")]) == 0
    assert load_study(tmp_path / "with.toml").valid.samefile(pictures / "valid")


def test_a_named_arm_draws_like_its_base_with_other_training(pictures, tmp_path):
    study = settled(pictures, tmp_path, arms=["mixed", FAST], fractions=[1.0])
    mixed, fast = study.runs
    assert (mixed.name, fast.name) == ("mixed-100-seed0", "fast-100-seed0")
    assert study.draws(mixed).digest == study.draws(fast).digest
    assert (mixed.settings.warmup, fast.settings.warmup) == (0.02, 0.5)
    assert fast.settings.model_copy(update={"warmup": 0.02}) == mixed.settings


def test_a_named_arm_of_another_model_has_that_models_defaults(pictures, tmp_path):
    (tmp_path / "w.pth").write_bytes(b"weights")
    other = {"name": "other", "base": "mixed", "train": {"model": "nano", "weights": "w.pth"}}
    train = {"model": "small", "budget": 24, "batch": 6}
    study = settled(pictures, tmp_path, arms=["mixed", other], fractions=[1.0], train=train)
    mixed, other = (run.settings for run in study.runs)
    assert (mixed.resolution, mixed.batch, mixed.accumulate, mixed.schedule) == (320, 6, 1, "cosine")
    assert (other.resolution, other.batch, other.accumulate, other.schedule) == (384, 6, 4, "step")
    assert mixed.augmentation != other.augmentation
    assert (mixed.weights, other.weights) == (tiny_weights(), str(tmp_path / "w.pth"))


def test_a_study_warns_of_equal_shares_and_of_arms_without_photographs_or_a_class(pictures, tmp_path):
    keys = {"fractions": [1.0, 0.99, 0.05], "train": SMALL | {"budget": 1}, "seeds": list(range(4))}
    warned = settled(pictures, tmp_path, **keys).warnings
    assert any("seed 0: 100 % and 99 % are the same 16 photographs" in line for line in warned)
    assert any("mixed-100-seed" in line and "no photograph" in line for line in warned)
    lacking = [line for line in warned if "photographs show no" in line]
    assert {line.split(":")[0] for line in lacking} == {f"real-5-seed{seed}" for seed in range(4)}
    drowned = {"fractions": [0.05], "seeds": [0], "train": SMALL | {"budget": 100}}
    for arms, warns in ((["real", "mixed"], True), (["real", "mixed", "balanced"], False)):
        assert (
            any("arm balanced" in line for line in settled(pictures, tmp_path, arms=arms, **drowned).warnings) == warns
        )
