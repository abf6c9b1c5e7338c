"""`hulldown study run --scheduler` on real Dask workers, one of which is lost."""

import json
import os
import threading
import time
from pathlib import Path

import pytest

from hulldown.cluster.scheduler import Scheduler
from hulldown.tests.clusters import cluster
from hulldown.tests.test_study import SMALL, settled, tree
from hulldown.tests.training_pictures import make_datasets
from hulldown.training.study import runs
from hulldown.training.study.cluster_runs import training_workers
from hulldown.training.study.manifest import write_manifest
from hulldown.training.study.runs import NANNYS, RunOptions, manifest_digest, run_here, run_study, unseen
from hulldown.training.study.study_report import write_report

OPTIONS = RunOptions("cpu", 0)
AS_A_NANNY_DOES = dict.fromkeys(NANNYS, "1")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study of two runs."""
    folder = make_datasets(tmp_path_factory.mktemp("pictures"), real=4, synthetic=4, test=4)
    return settled(folder, folder, fractions=[1.0], train=SMALL | {"budget": 8})


def report_of(out):
    write_report(out)
    found = json.loads((out / "report.json").read_text())
    del found["times"]
    return found


@pytest.mark.thorough
def test_a_study_that_loses_a_worker_equals_one_on_this_machine(study, tmp_path, monkeypatch):
    for name in NANNYS:
        monkeypatch.delenv(name, raising=False)
    out, lines, lost = tmp_path / "out", [], []
    run_study(study, tmp_path / "here", options=OPTIONS)
    with cluster(tmp_path / "nodes") as nodes:  # Dask notices a killed worker immediately
        victim = nodes.add(resources="train=1", environment=AS_A_NANNY_DOES)

        def lose():
            while not (begun := list(out.glob("runs/*/config.json"))):
                time.sleep(0.05)
            victim.kill()
            nodes.add(resources="train=1", environment=AS_A_NANNY_DOES)
            lost.extend(begun)

        threading.Thread(target=lose, daemon=True).start()
        with training_workers(Scheduler(nodes.address), say=lines.append) as launch:
            done = run_study(study, out, options=OPTIONS, launch=launch)
    assert (len(done.finished), done.failed, len(lost)) == (2, {}, 1)
    assert sum("is gone; others do its tasks" in line for line in lines) == 1
    assert tree(out) == tree(tmp_path / "here")
    assert report_of(out) == report_of(tmp_path / "here")


@pytest.fixture
def out(study, tmp_path):
    write_manifest(study, tmp_path)
    return tmp_path


def test_a_worker_that_does_not_see_the_study_refuses_it(out):
    assert unseen(out, manifest_digest(out)) == ""
    assert unseen(Path("/nowhere"), manifest_digest(out)).startswith("does not see /nowhere")
    assert unseen(out, "0" * 64).startswith("sees another study in ")


def test_a_run_keeps_the_environment_of_its_worker(out, monkeypatch):
    """A run deleted the thread limits of all later tasks."""
    for name in NANNYS:
        monkeypatch.setenv(name, "1")
    before, seen = dict(os.environ), {}

    def in_a_process(*arguments):
        seen.update(arguments[-1])

    monkeypatch.setattr(runs, "in_a_process", in_a_process)
    assert run_here(out, "real-100-seed0", OPTIONS, lambda: True) is None
    assert os.environ == before
    assert not seen.keys() & set(NANNYS)
    assert seen.keys() | set(NANNYS) == before.keys()
