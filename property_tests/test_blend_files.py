"""Reading any .blend gives a report or a one-line error, never a traceback."""

import json
import os
import subprocess
import sys
import tempfile
import threading
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, event, given, settings

from hulldown.assets.bundle import load_scenery, load_vehicle
from hulldown.property_tests.blend_cases import cases
from hulldown.reading.export import Job, exported_by
from hulldown.reading.inspect import draw
from hulldown.reading.options import Options

MAKER = Path(__file__).with_name("blend_maker.py")
MANY = settings.default.max_examples * (10 if settings.default.max_examples >= 2000 else 2)  # 20,000 in thorough
PATIENCE_S = 600.0  # more counts as a hang, even on a busy machine; other tests check the limits


class Reader:
    """A process that makes and reads files, restarted when a damaged one has killed it.

    Damage to Blender's memory may end the process as late as at the next file.
    """

    def __init__(self) -> None:
        self.child: subprocess.Popen[str] | None = None
        self.folder = tempfile.TemporaryDirectory(prefix="hulldown-blends-")

    def ask(self, message: dict) -> dict:
        """The answer; {"ended": exit status} if the process has ended or hangs, "unmade" if it ended before reading."""
        if self.child is None:
            self.child = subprocess.Popen(
                [sys.executable, "-P", str(MAKER)],
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        reached = "unmade"
        child, timer = self.child, threading.Timer(PATIENCE_S, self.child.kill)
        timer.start()
        try:
            child.stdin.write(json.dumps(message) + "\n")
            child.stdin.flush()
            line = child.stdout.readline()
            if line == "reading\n":
                reached, line = "ended", child.stdout.readline()
            if line:
                return json.loads(line)
        except BrokenPipeError:
            pass
        finally:
            timer.cancel()
        return {reached: self.close()}

    def close(self) -> int | None:
        child, self.child = self.child, None
        if child is None:
            return None
        child.kill()
        child.communicate()
        return child.returncode


@pytest.fixture(scope="module")
def reader():
    made = Reader()
    yield made
    made.close()
    made.folder.cleanup()


@pytest.mark.blender
@settings(max_examples=MANY, suppress_health_check=list(HealthCheck))
@given(cases())
def test_every_blend_is_read_or_refused_in_one_line(reader, case):
    folder = Path(reader.folder.name)
    options = replace(Options(texture_size=16), **case["options"])
    job = Job(str(folder / "a.blend"), str(folder), "blend", case["kind"], "a", options)
    message = {"make": case["make"], "damage": case["damage"], "job": asdict(job)}
    damaged = case["odd"] == "damaged"
    answer = reader.ask(message)
    if {"ended", "unmade"} & answer.keys() and not damaged:
        answer = reader.ask(message)  # by a process that hasn't read anything yet
    assert "traceback" not in answer, answer["traceback"]
    event(f"{case['odd']}: {next(iter(answer))}")
    if "unmade" in answer:
        return  # Blender crashed while making it, so there is no file
    if "report" in answer:
        event("a report")
        use(job, drawn=case["drawn"])
    elif "error" in answer:
        assert "\n" not in answer["error"]["problem"]
    else:  # Blender itself may crash on a damaged file; the parent process reports that in one line
        assert damaged, answer


def use(job: Job, *, drawn: bool) -> None:
    """Use a read asset as `hulldown inspect` does."""
    read = exported_by(job)
    assert all("\n" not in line for line in read.report.notes())
    asset = (load_vehicle if read.report.kind == "vehicle" else load_scenery)(read.bundle)
    if drawn:
        draw(asset, size=8)
    assert read.tidy.is_file()
