"""Whatever a .blend holds, reading it is a report or one line of what is wrong with it: never a traceback."""

import json
import os
import subprocess
import sys
import tempfile
import threading
from dataclasses import asdict
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from reading.build import Options

ROOT = Path(__file__).resolve().parents[1]
MAKER = Path(__file__).with_name("blend_maker.py")
FILES_AT_A_TIME = 10 if settings.default.max_examples >= 1000 else 2  # of one example: thorough has 20,000 files
PATIENCE_S = 600.0  # what takes longer hangs, on a busy machine too; the limits of reading are tested elsewhere

numbers = st.one_of(
    st.floats(-100.0, 100.0, width=32),
    st.sampled_from([0.0, -0.0, 1e-30, 1e6, 5e6, 1e20, -3e38, float("nan"), float("inf"), float("-inf")]),
)
triples = st.tuples(numbers, numbers, numbers)
usual = st.just((1.0, 1.0, 1.0))
names = st.one_of(
    st.sampled_from(
        ["Hull", "Turret", "Gun", "ground", "Sky", "Tree.001", "", "\x1b[2J", "a/b", "../x", "[red]", "ü" * 40]
    ),
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20),
)
objects = st.fixed_dictionaries(
    {
        "type": st.sampled_from(
            [
                "cube",
                "cube",
                "plane",
                "text",
                "curve",
                "ball",
                "empty",
                "lattice",
                "armature",
                "light",
                "camera",
                "bare",
            ]
        ),
        "name": names,
        "location": st.one_of(st.just((0.0, 0.0, 0.0)), triples),
        "scale": st.one_of(usual, usual, triples),
        "rotation": st.one_of(st.just((0.0, 0.0, 0.0)), triples),
        "vertex": st.one_of(st.none(), st.none(), triples),
        "modifiers": st.lists(
            st.sampled_from(
                [
                    *("SUBSURF", "ARRAY", "MIRROR", "SOLIDIFY", "BOOLEAN", "DECIMATE", "CLOTH", "PARTICLE_SYSTEM"),
                    *("SKIN", "REMESH", "WIREFRAME", "SCREW", "ARMATURE", "SOFT_BODY", "OCEAN", "EXPLODE", "FLUID"),
                    "NODES",
                ]
            ),
            max_size=2,
        ),
        "hidden": st.sampled_from([False, False, False, True]),
        "collection": st.sampled_from([False, False, True]),
    }
)
files = st.fixed_dictionaries(
    {
        "objects": st.lists(objects, min_size=0, max_size=4),
        "parents": st.just([]),
        "unit": st.sampled_from([1.0, 1.0, 0.01, 1000.0, 1e-6]),
        "frame": st.sampled_from([1, 1, 0, -5, 1_000_000]),
    }
)
parents = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=3)
damages = st.fixed_dictionaries(
    {
        "bytes": st.one_of(st.just([]), st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), max_size=8)),
        "keep": st.sampled_from([1.0, 1.0, 1.0, 0.999, 0.9, 0.5, 0.01]),
    }
)
cases = st.tuples(files, parents, damages, st.sampled_from(["vehicle", "scenery", None]))


class Reader:
    """A process that makes and reads files, started anew when a damaged one has killed it.

    What a damaged file has done to Blender's memory may end the process as late as at the next file.
    """

    def __init__(self) -> None:
        self.child: subprocess.Popen[str] | None = None
        self.folder = tempfile.TemporaryDirectory(prefix="hulldown-blends-")

    def ask(self, message: dict) -> dict:
        """The answer; {"ended": exit status} if the process has ended or hangs."""
        if self.child is None:
            self.child = subprocess.Popen(
                [sys.executable, "-P", str(MAKER)],
                env={**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        child, timer = self.child, threading.Timer(PATIENCE_S, self.child.kill)
        timer.start()
        try:
            child.stdin.write(json.dumps(message) + "\n")
            child.stdin.flush()
            said = child.stdout.readline()
            if said == "reading\n":
                said = child.stdout.readline()
            if said:
                return json.loads(said)
        except BrokenPipeError:
            pass
        finally:
            timer.cancel()
        return {"ended": self.close()}

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
@settings(suppress_health_check=list(HealthCheck))
@given(batch=st.lists(cases, min_size=FILES_AT_A_TIME, max_size=FILES_AT_A_TIME))
def test_every_blend_is_read_or_refused_in_one_line(reader, batch):
    folder = Path(reader.folder.name)
    for said, related, damaged, kind in batch:
        job = {
            **{"given": "a.blend", "path": str(folder / "a.blend"), "format": "blend", "kind": kind, "name": "a"},
            **{"options": asdict(Options()), "bundle": str(folder / "bundle.npz"), "tidy": str(folder / "tidy.blend")},
            "answer": str(folder / "answer.json"),
        }
        related = related if said["objects"] else []
        message = {"make": {**said, "parents": related}, "damage": damaged, "job": job}
        sound = damaged["keep"] == 1.0 and not damaged["bytes"]
        answer = reader.ask(message)
        if sound and "ended" in answer:
            answer = reader.ask(message)  # by a process that has read nothing yet
        assert "traceback" not in answer, answer["traceback"]
        if "error" in answer:
            assert "\n" not in answer["error"]["problem"]
        else:  # Blender itself may crash on what is damaged, and that is said in one line by who has started it
            assert "report" in answer or ("ended" in answer and not sound), answer
