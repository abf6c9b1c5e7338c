"""Kills of `hulldown render` and of Blender: the dataset must equal that of an undisturbed run."""

import shutil
import subprocess
import sys
import time

import psutil
import pytest

from hulldown.tests.blender_plans import IMAGES, plan_in
from hulldown.tests.oracles.resuming import differences

pytestmark = pytest.mark.blender


def started(plan, dataset):
    command = [sys.executable, "-P", "-m", "hulldown.cli", "render", str(plan), "-o", str(dataset), "--device", "cpu"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def wait_for(run, dataset, pictures):
    """Wait until a run has added these pictures, and is still running."""
    while len(list((dataset / "images").glob("*"))) < pictures:
        assert run.poll() is None
        time.sleep(0.01)


@pytest.fixture(scope="module")
def folder(own_worlds):
    """A plan, rendered into `whole` by an undisturbed run and into `killed` with kills."""
    plan, dataset = plan_in(own_worlds), own_worlds / "killed"
    assert started(plan, own_worlds / "whole").wait() == 0
    run = started(plan, dataset)
    wait_for(run, dataset, 2)
    psutil.Process(run.pid).children()[-1].kill()
    wait_for(run, dataset, 5)
    run.kill()
    run.wait()
    assert started(plan, dataset).wait() == 0
    return own_worlds


def test_two_kills_lose_and_double_nothing(folder):
    found = differences(folder / "whole", folder / "killed")
    assert found == dict.fromkeys(found, 0)
    assert len(list((folder / "killed" / "images").iterdir())) == IMAGES


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("lost", "files lost"),
        ("other", "files that differ"),
        ("left over", "files too many"),
        ("journal line twice", "files that differ"),
    ],
)
def test_the_comparison_finds(folder, tmp_path, what, expected):
    changed = tmp_path / "changed"
    shutil.copytree(folder / "killed", changed)
    first, second = sorted((changed / "images").iterdir())[:2]
    if what == "lost":
        first.unlink()
    elif what == "other":
        shutil.copy(second, first)
    elif what == "left over":
        (changed / ".unfinished").mkdir()
        shutil.copy(first, changed / ".unfinished")
    else:
        lines = (changed / "journal.jsonl").read_bytes().splitlines(keepends=True)
        (changed / "journal.jsonl").write_bytes(b"".join([*lines[:3], *lines[2:]]))
    found = differences(folder / "whole", changed)
    assert {key: n for key, n in found.items() if n} == {expected: 1}
