"""What a worker of a shared machine does with its part of the cores."""

import queue
import time

import psutil
import pytest

from planning.plan_file import read_plan
from render.jobs import render_assets, render_job
from render.messages import Settings, to_json
from render.process import WorkerProcess, worker_command
from tests.blender_plans import make_worlds, plan_in


@pytest.mark.blender
def test_a_worker_of_one_core_sleeps_when_it_has_nothing_to_do(tmp_path):
    """Blender held to one thread kept a core busy for as long as it lived."""
    make_worlds(tmp_path)
    plan = read_plan(plan_in(tmp_path, images=1))
    answers = queue.SimpleQueue()
    worker = WorkerProcess(worker_command(None), tmp_path / "log", lambda _, answer: answers.put(answer))
    worker.send({"do": "start", "device": "cpu", "index": 0, "threads": 1})
    worker.send(to_json(render_job(plan[0], render_assets(plan), Settings(2, False, 0.0, 2), tmp_path / "0.png")))
    assert "ready" in answers.get(timeout=120)
    assert [answers.get(timeout=300)["done"] for _ in range(2)] == ["start", "render"]
    process = psutil.Process(worker.pid)
    before = sum(process.cpu_times()[:2])
    time.sleep(2.0)
    assert sum(process.cpu_times()[:2]) - before < 0.5
    worker.stop()
