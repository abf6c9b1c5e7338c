"""hulldown study: runs, draws, and that a killed study ends as one left alone."""

import json
import os
import signal
import threading

import numpy as np
import pytest
import torch

from cli import main
from geometry.errors import HulldownError
from tests.test_train import in_child
from tests.training_pictures import make_dataset
from training.study.arms import Run, arm_draws, budget_of, study_runs
from training.study.config import load_study
from training.study.manifest import read_manifest, settle
from training.study.runs import Options, read_failures, run_one, run_study

SMALL = {"model": "small", "resolution": 64, "budget": 24, "batch": 4}
NANO = {"model": "nano", "resolution": 64, "budget": 4, "batch": 1, "weights": "none", "queries": 8, "groups": 1}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    for seed, (name, count) in enumerate({"real": 16, "synthetic": 12, "test": 8, "valid": 4}.items()):
        make_dataset(folder / name, count, seed=seed)
    return folder


def written(folder, path, *, train=SMALL, **keys):
    """A study.toml for the pictures."""
    keys = {"arms": ["real", "mixed"], "fractions": [1.0, 0.5], "seeds": [0]} | keys
    lines = [f"{name} = {json.dumps(str(folder / name))}" for name in ("real", "synthetic", "test") if name not in keys]
    lines += [f"{key} = {json.dumps(value)}" for key, value in keys.items()]
    lines += ["[train]", *(f"{key} = {json.dumps(value)}" for key, value in train.items())]
    path.write_text("\n".join(lines))
    return path


def settled(folder, path, **keys):
    return settle(load_study(written(folder, path / "study.toml", **keys)))


def here(study, name, options, progress, stop):
    """A run in this process."""
    run_one(study, name, options, progress)


def study_in_child(study, out, *, kill_at=None):
    """Run a study on one thread in a process of its own, which kills itself at (run's name, what, done)."""

    def progress(what, done, total):
        if kill_at is not None and all(word in what for word in kill_at[:2]) and done == kill_at[2]:
            os.kill(os.getpid(), signal.SIGKILL)

    return in_child(
        lambda: run_study(study, out, options=Options("cpu", 0), launch=here, progress=progress)
    )


def tree(out):
    """What must be equal in two studies: weights, draws, detections."""
    manifest = read_manifest(out)
    found = {}
    for run in manifest.runs:
        folder = out / "runs" / run.folder
        state = torch.load(folder / "weights.pt", weights_only=True)["model"]
        found[run.name] = (
            {key: value.numpy().tobytes() for key, value in state.items()},
            (folder / "draws.csv").read_bytes(),
            [path.read_bytes() for path in sorted(folder.glob("test-*.json")) if ".info" not in path.name],
        )
    return found


@pytest.mark.parametrize(
    ("keys", "kills"),
    [
        ({}, [("mixed-100", "training", 3), ("mixed-50", "looking", 8)]),
        ({"train": NANO, "fractions": [1.0]}, [("real", "training", 1), ("mixed", "training", 1)]),
    ],
    ids=["small", "nano"],
)
def test_a_study_killed_twice_ends_as_one_left_alone(pictures, tmp_path, keys, kills):
    study = settled(pictures, tmp_path, **keys)
    assert study_in_child(study, tmp_path / "alone") == 0
    for kill in kills:
        assert study_in_child(study, tmp_path / "killed", kill_at=kill) == -signal.SIGKILL
    assert study_in_child(study, tmp_path / "killed") == 0
    assert tree(tmp_path / "alone") == tree(tmp_path / "killed")
    assert len(tree(tmp_path / "alone")) == (4 if not keys else 2)
