import json
import os
import signal
import traceback
from pathlib import Path

import numpy as np
import pytest
import torch

from hulldown.geometry.errors import HulldownError
from hulldown.tests.training_pictures import make_dataset
from hulldown.training.predict import load_detector
from hulldown.training.settings import load_settings
from hulldown.training.train import train


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("pictures") / "set", 24)


def small(**changes):
    base = {"model": "small", "resolution": 64, "budget": 47, "batch": 4, "accumulate": 2}
    return load_settings(None, base | changes)


def nano(**changes):
    base = {"model": "nano", "resolution": 64, "budget": 24, "batch": 1, "accumulate": 2, "weights": "none"}
    return load_settings(None, base | {"queries": 8, "groups": 1} | changes)


def in_child(run) -> int:
    """Run in a process of its own that shares what is imported, on one thread; how it ended."""
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


@pytest.mark.parametrize(
    ("settings", "kills"),
    [
        (small(budget=95), (6, 10)),
        (nano(budget=12), (5,)),
        pytest.param(nano(), (6, 10), marks=pytest.mark.thorough),
    ],
    ids=["small", "nano once", "nano"],
)
def test_a_run_that_is_killed_ends_as_one_left_alone(pictures, tmp_path, settings, kills):
    data = {"demo": pictures}
    assert train_and_die(data, tmp_path / "alone", settings, workers=0) == 0
    measured = {"workers": 1, "valid": make_dataset(tmp_path / "valid", 4)}  # which changes no weight
    for at in kills:
        assert train_and_die(data, tmp_path / "killed", settings, at=at, **measured) == -signal.SIGKILL
        assert json.loads((tmp_path / "killed" / "run.json").read_text())["status"] == "running"
    assert train_and_die(data, tmp_path / "killed", settings, **measured) == 0
    alone, killed = weights(tmp_path / "alone"), weights(tmp_path / "killed")
    assert alone["model"].keys() == killed["model"].keys()
    for key, value in alone["model"].items():
        assert torch.equal(value, killed["model"][key]), key
    tables = [(tmp_path / name / "metrics.csv").read_text().splitlines() for name in ("alone", "killed")]
    losses = [[line.split(",")[:3] for line in table] for table in tables]
    assert losses[0] == losses[1]
    curve = (tmp_path / "killed" / "validation.csv").read_text().splitlines()
    assert len(curve) == (7 if settings.budget == 12 else 11)
    assert int(curve[-1].split(",")[0]) == len(losses[0]) - 1
    run = json.loads((tmp_path / "killed" / "run.json").read_text())
    assert run["status"] == "finished"
    assert run["steps"] == len(losses[0]) - 1
    assert sum(source["drawn"] for source in run["sources"].values()) == settings.budget
    assert not list((tmp_path / "killed").glob("*.ckpt"))
    detector = load_detector(tmp_path / "killed", "cpu")
    assert detector.classes == ("square", "disc")
    images = [np.zeros((30, 50, 3), dtype=np.uint8), np.zeros((54, 96, 3), dtype=np.uint8)]
    for found, image in zip(detector.detect(images), images, strict=True):
        assert found.xywh.shape == (len(found.score), 4)
        assert (np.diff(found.score) <= 0).all()
        assert set(found.label) <= {0, 1}
        corner = found.xywh[:, :2] + found.xywh[:, 2:]
        assert (found.xywh[:, :2] >= -1e-3).all()
        assert (corner <= np.array(image.shape[1::-1]) + 1e-3).all()
    with pytest.raises(HulldownError, match=r"the run in this folder has settings.seed = 0, not 1"):
        train(data, tmp_path / "killed", settings=settings.model_copy(update={"seed": 1}), **measured)
