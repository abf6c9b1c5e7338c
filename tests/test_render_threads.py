"""What a worker of a shared machine does with its part of the cores."""

import time

import psutil
import pytest

from hulldown.benchmarks.rendering import Talk
from hulldown.planning.plan_file import read_plan
from hulldown.render.jobs import render_assets, render_job
from hulldown.render.messages import Settings, to_json
from hulldown.tests.blender_plans import copied, plan_in


@pytest.mark.blender
def test_a_worker_of_one_core_sleeps_when_it_has_nothing_to_do(worlds, tmp_path):
    """Blender held to one thread kept a core busy for as long as it lived."""
    plan = read_plan(plan_in(copied(worlds, tmp_path), images=1))
    talk = Talk(tmp_path, threads=1)
    talk.ask(to_json(render_job(plan[0], render_assets(plan), Settings(2, False, 0.0, 2), tmp_path / "0.png")))
    process = psutil.Process(talk.worker.pid)
    before = sum(process.cpu_times()[:2])
    time.sleep(2.0)
    assert sum(process.cpu_times()[:2]) - before < 0.5
    talk.worker.stop()
