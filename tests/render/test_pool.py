"""A pool of workers that crash, hang, grow, or refuse."""

import os

import pytest

from hulldown.base.child import Stopped
from hulldown.base.errors import HulldownError
from hulldown.camera.intrinsics import Intrinsics
from hulldown.render import process
from hulldown.render.blender.messages import CameraInput, CyclesSettings, LightInput, RenderJob
from hulldown.render.pool import Engine, Pool
from hulldown.render.process import FIRST_JOBS, Limits


class Work:
    """Jobs that behave as told, and their outcomes."""

    def __init__(self, folder, how):
        self.how, self.folder = how, folder
        self.done, self.failed, self.lines, self.pids, self.restarts = [], {}, [], {}, 0

    def run(self, folder, blender, *, stopping=lambda: False, **options):
        engine = Engine(blender=blender, device="cpu", **options)
        with Pool(folder / "logs", engine, say=self.lines.append, stopping=stopping) as pool:
            for job, outcome in pool.results(range(len(self.how)), self.job):
                self.restarts += outcome.restarts
                if outcome.reasons:
                    self.failed[job] = outcome.reasons
                else:
                    self.done.append(job)
                    self.pids[job] = int((self.folder / f"{job}.pid").read_text())

    def job(self, number):
        camera = CameraInput([], Intrinsics(1, 1, 1.0), 0.1, 0.0, 0.0)
        scenery, light = self.how[number], LightInput("", 0.0, 1.0, None)
        settings, output = CyclesSettings(1, False, 0.0, 1), str(self.folder / f"{number}.png")
        return RenderJob(scenery, [], camera, light, None, 0, settings, output)


@pytest.mark.parametrize("workers", [1, 3])
def test_all_jobs_are_done_once_and_in_order_by_one_worker(tmp_path, blender, workers):
    work = Work(tmp_path, [""] * 20)
    work.run(tmp_path, blender, workers=workers)
    assert (work.done if workers == 1 else sorted(work.done)) == list(range(20))
    assert work.failed == {}
    assert work.restarts == 0
    assert len(set(work.pids.values())) <= workers


def test_the_next_job_begins_before_an_outcome_is_handed_out(tmp_path, blender):
    work, begun = Work(tmp_path, [""] * 5), []
    with Pool(tmp_path / "logs", Engine(blender=blender, device="cpu", workers=1)) as pool:
        for job, _ in pool.results(range(5), lambda number: begun.append(number) or work.job(number)):
            assert begun[-1] == min(job + 1, 4)


def test_no_jobs_start_no_worker(tmp_path, blender):
    Work(tmp_path, []).run(tmp_path, blender, workers=2)
    assert not (tmp_path / "logs").exists()


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("crash", "ended by signal 11; its last words: Segmentation fault, as asked"),
        ("exit", "ended with exit code 3"),
        ("hang", "no answer within 0.5 s"),
        ("grow", "more than the limit of 0.16 GiB"),
        ("fail", "ValueError: as asked"),
        ("cut", "Blender wrote a picture that cannot be read"),
    ],
)
def test_a_job_is_given_up_after_three_failures_and_the_others_continue(tmp_path, blender, how, reason):
    work = Work(tmp_path, ["", how, "", ""])
    limits = Limits(job_s=0.5 if how == "hang" else 60.0, memory_bytes=160 * 2**20)
    work.run(tmp_path, blender, workers=1, limits=limits)
    assert sorted(work.done) == [0, 2, 3]
    assert list(work.failed) == [1]
    assert len(work.failed[1]) == 3
    assert all(reason in r for r in work.failed[1])
    assert sum(reason in line for line in work.lines) == 3  # each retry is reported
    assert work.restarts == (0 if how in ("fail", "cut") else 3)


def test_a_job_that_takes_much_longer_than_the_first_ones_is_ended(tmp_path, blender, monkeypatch):
    monkeypatch.setattr(process, "MIN_TIME_LIMIT_S", 2.0)
    work = Work(tmp_path, [""] * FIRST_JOBS + ["hang", ""])
    work.run(tmp_path, blender, workers=1)
    assert sorted(work.done) == [*range(FIRST_JOBS), FIRST_JOBS + 1]
    assert all("no answer within" in reason for reason in work.failed[FIRST_JOBS])


def test_a_crash_costs_one_attempt_and_a_restart(tmp_path, blender):
    work = Work(tmp_path, ["", "crash:2", ""])
    work.run(tmp_path, blender, workers=1)
    assert sorted(work.done) == [0, 1, 2]
    assert work.failed == {}
    assert work.restarts == 2
    assert any("it is started again" in line for line in work.lines)


def test_a_worker_near_its_memory_limit_is_replaced_between_jobs(tmp_path, blender):
    work = Work(tmp_path, ["hold"] * 3)
    work.run(tmp_path, blender, workers=1, limits=Limits(memory_bytes=165 * 2**20))
    assert work.done == [0, 1, 2]
    assert len(set(work.pids.values())) == 3
    assert work.restarts == 0


def test_a_blender_that_cannot_be_started_is_an_error(tmp_path):
    blender = tmp_path / "blender"
    blender.write_text("#!/nowhere\n")
    blender.chmod(0o755)
    with pytest.raises(HulldownError, match=r"blender.*cannot be started"):
        Work(tmp_path, [""]).run(tmp_path, str(blender), workers=1)


def test_stopping_ends_the_workers(tmp_path, blender):
    work = Work(tmp_path, ["", "hang"])
    with pytest.raises(Stopped):
        work.run(tmp_path, blender, workers=1, stopping=lambda: bool(work.done))
    with pytest.raises(ProcessLookupError):
        os.kill(work.pids[0], 0)
