"""Reading any .blend gives a report or a one-line error, never a traceback."""

import contextlib
import json
import os
import queue
import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from hulldown.assets.bundle import load_scenery, load_vehicle
from hulldown.base.child import Child
from hulldown.reading.inspect import draw_asset
from hulldown.reading.pieces.options import Options
from hulldown.reading.reader_process import Job, finished_export

MAKER = Path(__file__).with_name("blend_maker.py")
MANY = settings.default.max_examples * (10 if settings.default.max_examples >= 2000 else 2)  # 20,000 in thorough
PATIENCE_S = 600.0  # more counts as a hang, even on a busy machine; other tests check the limits

VEHICLES = (
    *("modifiers", "instances", "surfaces", "armature", "nodes", "keyframes", "collections", "no_origins"),
    *("textured", "odd_ones"),
)
SCENERIES = ("scattered", "hairy", "furry", "unnamed", "map_in_object")
FILES = [*((name, "vehicle") for name in VEHICLES), *((name, "scenery") for name in SCENERIES)]
ODD_NUMBERS = [0.0, -0.0, 1e-30, 1e6, 5e6, 1e20, -3e38, float("nan"), float("inf"), float("-inf")]
numbers = st.floats(-100.0, 100.0, width=32) | st.sampled_from(ODD_NUMBERS)
triples = st.tuples(numbers, numbers, numbers)
names = st.one_of(
    st.sampled_from(["Hull", "Turret", "Gun", "gun barrel", "Wheel", "ground", "Sky", "Water", "Tree.001", "Road"]),
    st.sampled_from(["", "\x1b[2J", "a/b", "../x", "[red]", "ü" * 40, "*", "mesh:x"]),
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20),
)
modifiers = st.sampled_from([
    *("SUBSURF", "ARRAY", "MIRROR", "SOLIDIFY", "BOOLEAN", "DECIMATE", "CLOTH", "PARTICLE_SYSTEM", "PARTICLE_SYSTEM"),
    *("SKIN", "REMESH", "WIREFRAME", "SCREW", "ARMATURE", "SOFT_BODY", "OCEAN", "EXPLODE", "FLUID", "DYNAMIC_PAINT"),
    *("NODES", "NODES", "NODES"),
])  # fmt: skip
empty_data = ("meshes", "hair_curves", "pointclouds", "volumes", "grease_pencils", "lattices", "metaballs", "lights")
changes = {
    "name": names,
    **dict.fromkeys(("location", "scale", "rotation_euler", "move a vertex"), triples),
    **dict.fromkeys(("hide_render", "carry", "refer", "follow"), st.just(True)),
    "hang on": st.integers(0, 7),
    "dress": st.sampled_from(["bare", "glass", "holes", "leaves"]),
    "modify": modifiers,
    "add hair": st.sampled_from([0, 4]),
    "add": st.sampled_from(empty_data),
}
change = st.sampled_from(sorted(changes)).flatmap(lambda key: st.tuples(st.integers(0, 40), st.just(key), changes[key]))
no_damage = {"bytes": [], "keep": 1.0}
damages = st.one_of(
    st.builds(dict, bytes=st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), min_size=1, max_size=40),
              keep=st.just(1.0)),
    st.builds(dict, bytes=st.just([]), keep=st.sampled_from([0.999, 0.9, 0.5, 0.01])),
)  # fmt: skip
patterns = st.sampled_from(["Turret", "Gun", "Cube*", "*", "", "mesh:*", "material:water*", "carrier", "[", "none"])
pivots = st.sampled_from(["Turret", "Hull", "none"]) | st.tuples(*[st.floats(-1e6, 1e6)] * 3)
reading = {
    "up": st.sampled_from(["z", "y", "-z", "x"]),
    "scale": st.sampled_from([0.01, 0.0254, 1e-9, 1e9]),
    "forward": st.sampled_from(["+x", "-y"]) | st.floats(-360.0, 360.0) | st.tuples(st.just(1.0), st.floats(-9.0, 9.0)),
    **dict.fromkeys(("turret", "gun"), patterns),
    **dict.fromkeys(("turret_pivot", "gun_pivot"), pivots),
    **dict.fromkeys(("keep", "drop", "ground", "not_ground", "water"), st.tuples(patterns)),
}
options = st.sampled_from(sorted(reading)).flatmap(lambda key: st.builds(lambda value: {key: value}, reading[key]))


@st.composite
def cases(draw: st.DrawFn) -> dict:
    """A file: its content, damage, kind, and reading options."""
    name, kind = draw(st.sampled_from(FILES))
    damaged = draw(st.sampled_from([False] * 8 + [True]))
    return {
        "damaged": damaged,
        "make": {
            "case": name,
            "changes": draw(st.lists(change, max_size=4)),
            "unit": draw(st.sampled_from([1.0] * 8 + [0.01, 1000.0, 1e-6])),
            "fewest": draw(st.sampled_from([1, 1000])),  # objects of which only one is evaluated
            "frame": draw(st.sampled_from([1] * 16 + [0, -5, 50, 1_000_000])),
        },
        "damage": draw(damages) if damaged else no_damage,
        "kind": draw(st.sampled_from([kind, kind, kind, None])),
        "drawn": draw(st.sampled_from([True] + [False] * 9)),  # whether to draw what was read, which takes long
        "options": draw(st.one_of(st.just({}), st.just({}), options)),
    }


class Reader:
    """A process that makes and reads files, restarted when a damaged one has killed it.

    Damage to Blender's memory may end the process as late as at the next file.
    """

    def __init__(self) -> None:
        self.child: Child | None = None
        self.folder = tempfile.TemporaryDirectory(prefix="hulldown-blends-")

    def ask(self, message: dict) -> dict:
        """The answer; {"ended": exit status} if the process has ended or hangs, "unmade" if it ended before reading."""
        if self.child is None:
            self.heard: queue.SimpleQueue[bytes] = queue.SimpleQueue()
            command = [sys.executable, "-P", str(MAKER), self.folder.name]
            env = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
            self.child = Child(command, env=env, on_line=self.heard.put, log=Path(self.folder.name, "log"))
        self.child.write(json.dumps(message).encode() + b"\n")
        reached = "unmade"
        with contextlib.suppress(queue.Empty):
            line = self.heard.get(timeout=PATIENCE_S)
            if line == b"reading\n":
                reached, line = "ended", self.heard.get(timeout=PATIENCE_S)
            if line:
                return json.loads(line)
        return {reached: self.close()}

    def close(self) -> int | None:
        child, self.child = self.child, None
        return child and child.kill()


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
    job = Job(str(folder / "a.blend"), str(folder), "blend", case["kind"], options)
    message = {"make": case["make"], "damage": case["damage"], "job": asdict(job)}
    answer = reader.ask(message)
    if {"ended", "unmade"} & answer.keys() and not case["damaged"]:
        answer = reader.ask(message)  # by a process that hasn't read anything yet
    assert "traceback" not in answer, answer["traceback"]
    event(f"{case['make']['case']}: {next(iter(answer))}")
    if "unmade" in answer:
        return  # Blender crashed while making it, so there is no file
    if "report" in answer:
        event("a report")
        use(job, drawn=case["drawn"])
    elif "error" in answer:
        assert "\n" not in answer["error"]["problem"]
    else:  # Blender itself may crash on a damaged file; the parent process reports that in one line
        assert case["damaged"], answer


def use(job: Job, *, drawn: bool) -> None:
    """Use a read asset as `hulldown inspect` does."""
    read = finished_export(job)
    assert all("\n" not in line for line in read.report.lines())
    asset = (load_vehicle if read.report.kind == "vehicle" else load_scenery)(read.bundle)
    if drawn:
        draw_asset(asset, size=8)
    assert read.tidy.is_file()
