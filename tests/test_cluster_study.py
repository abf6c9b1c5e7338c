"""`hulldown study run --scheduler` on real Dask workers, one of which is lost."""

import hashlib
import json
import threading
import time

import pytest

from benchmarks.clusters import cluster
from geometry.errors import HulldownError
from render.scheduler import Scheduler
from tests.test_study import SMALL, tree, written
from tests.training_pictures import make_dataset
from training.study.config import load_study
from training.study.elsewhere import NANNYS, Answer, Order, code, run_here
from training.study.manifest import settle, write_manifest
from training.study.report import write_report
from training.study.runs import Options, run_study
from verbs.cluster import training_workers

OPTIONS = Options("cpu", 0)
AS_A_NANNY_DOES = dict.fromkeys(NANNYS, "1")


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study of two runs."""
    folder = tmp_path_factory.mktemp("pictures")
    for seed, name in enumerate(("real", "synthetic", "test")):
        make_dataset(folder / name, 4, seed=seed)
    return settle(load_study(written(folder, folder / "study.toml", fractions=[1.0], train=SMALL | {"budget": 8})))


def report_of(out):
    write_report(out)
    found = json.loads((out / "report.json").read_text())
    del found["times"]
    return found


def wait_for(path):
    while not path.exists():
        time.sleep(0.05)


def test_a_study_that_loses_a_worker_reports_as_one_on_this_machine(study, tmp_path):
    out, said, lost = tmp_path / "out", [], []
    run_study(study, tmp_path / "here", options=OPTIONS)
    with cluster(tmp_path / "nodes") as nodes:  # a killed worker is missed at once
        victim = nodes.add(resources="train=1", environment=AS_A_NANNY_DOES)

        def lose(folder):
            wait_for(out / "runs" / folder / "config.json")
            victim.kill()
            nodes.add(resources="train=1", environment=AS_A_NANNY_DOES)
            lost.append(folder)

        def say(line):
            said.append(line)
            if "begins on" in line and sum("begins on" in each for each in said) == 1:
                run = study.manifest.run(line.split(":")[0])
                threading.Thread(target=lose, args=(run.folder,), daemon=True).start()

        with training_workers(Scheduler(nodes.address), say=say) as launch:
            done = run_study(study, out, options=OPTIONS, launch=launch, at_once=2)
    assert (len(done.finished), done.failed, len(lost)) == (2, {}, 1)
    assert sum("was lost; another goes on" in line for line in said) == 1
    assert sum("begins on" in line for line in said) == 3
    assert tree(out) == tree(tmp_path / "here")
    assert report_of(out) == report_of(tmp_path / "here")


def order_for(settled, out, **changes):
    write_manifest(settled, out)
    manifest = hashlib.sha256((out / "study.json").read_bytes()).hexdigest()
    order = Order(code=code(), study=str(out), manifest=manifest, name="real-100-seed0", device="cpu", workers=0)
    return order.model_copy(update=changes).model_dump_json().encode()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"code": "hulldown 0.0.1"}, r"has hulldown .*torch .*, and the client hulldown 0\.0\.1$"),
        ({"study": "/nowhere"}, r"does not see /nowhere, which all machines must share$"),
        ({"manifest": "0" * 64}, r"sees another study in .*out$"),
    ],
)
def test_a_worker_that_cannot_run_a_study_says_why(study, tmp_path, changes, says):
    (tmp_path / "out").mkdir()
    answer = Answer.model_validate_json(run_here(order_for(study, tmp_path / "out", **changes), lambda: True))
    with pytest.raises(HulldownError, match=says):
        raise HulldownError(answer.refused)
