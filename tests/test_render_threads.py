"""CPU time of a worker that has only some of the cores."""

import time

import psutil
import pytest

from hulldown.planning.plan_file import read_plan
from hulldown.render.jobs import render_assets
from hulldown.render.process import DEFAULT_LIMITS, Allowance, Blender
from hulldown.tests.blender_plans import copied, drawn, job, plan_in


@pytest.mark.blender
def test_an_idle_worker_with_one_core_sleeps(worlds, tmp_path):
    """A Blender limited to one thread kept a core busy while idle."""
    plan = read_plan(plan_in(copied(worlds, tmp_path), images=1))
    settings = {"samples": 2, "denoise": False, "adaptive_threshold": 0.0, "bounces": 2}
    alone = Allowance(DEFAULT_LIMITS, blenders=psutil.cpu_count())
    with Blender(tmp_path / "log", allowance=alone) as blender:
        drawn(blender, job(plan[0], render_assets(plan), settings, tmp_path / "0.png"))
        process = psutil.Process(blender.pid)
        before = sum(process.cpu_times()[:2])
        time.sleep(2.0)
        assert sum(process.cpu_times()[:2]) - before < 0.5
