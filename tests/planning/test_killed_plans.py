"""kill -9 of planning at any moment: no process is left, and the same call continues with the same bytes."""

import multiprocessing
import multiprocessing.forkserver
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from hulldown.planning.write import write_plan
from hulldown.tests.builders.planning_assets import small_assets, small_config

FORK = multiprocessing.get_context("fork")  # imports and builds once, before forking
CONFIG = small_config(budget={"images_per_class": 16, "images_per_position": 2})
ASSETS = small_assets()
PATIENCE = 60.0  # seconds after which a process that doesn't end is a failure


def start(path: Path, workers: int) -> multiprocessing.Process:
    process = FORK.Process(target=plan_alone, args=(path, workers))
    process.start()
    return process


def plan_alone(path: Path, workers: int) -> None:
    """Write the plan in a forked process, where the fork server of an earlier test isn't a child (CPython 3.11)."""
    multiprocessing.forkserver._forkserver.__init__()
    write_plan(CONFIG, ASSETS, path, workers=workers)


@pytest.fixture(scope="module", autouse=True)
def small_blocks() -> Iterator[None]:
    """Write small blocks, so that a killed plan has rows to continue from."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hulldown.planning.write._MIN_BLOCK_POSITIONS", 3)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, float]:
    """The uninterrupted plan, and its duration in seconds."""
    path = tmp_path_factory.mktemp("whole") / "plan.jsonl"
    began = time.perf_counter()
    start(path, 2).join(PATIENCE)  # in a separate process, since forking is unsafe where workers were started
    return path.read_bytes(), time.perf_counter() - began


@pytest.mark.parametrize("workers", [1, 2])
def test_a_plan_killed_at_random_moments_is_completed_with_the_same_bytes(
    whole: tuple[bytes, float], tmp_path: Path, workers: int
) -> None:
    rng, path = np.random.default_rng(workers), tmp_path / "plan.jsonl"
    for moment in rng.uniform(0.0, 0.9 * whole[1], 3):
        process = start(path, workers)
        process.join(moment)
        assert process.pid is not None
        children = psutil.Process(process.pid).children() if process.is_alive() else []
        process.kill()
        process.join(PATIENCE)
        _, left = psutil.wait_procs(children, timeout=PATIENCE)
        assert not left, "workers outlive their parent process"
    last = start(path, workers)
    last.join(PATIENCE)
    assert last.exitcode == 0
    assert path.read_bytes() == whole[0]
    assert [p.name for p in tmp_path.iterdir()] == ["plan.jsonl"]
