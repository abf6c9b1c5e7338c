"""Resuming: a run that is killed again and again, beside one that is left alone; the two datasets must be equal.

Real Blender, tiny pictures. Whoever is killed, run or worker, is killed without warning (SIGKILL).
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from matplotlib.figure import Figure

from benchmarks.rendering import planned
from dataset.coco import LOCK_NAME
from dataset.document import JOURNAL_NAME
from dataset.journal import MERGED
from demo.project import create_project
from render.session import LOGS_NAME

ROOT = Path(__file__).parents[1]
SIZE = (96, 54)
POLL_S = 0.01
STARTING_S = 6.0  # in which Blender starts and the scenery is loaded, and some more
IMAGE_S = 0.5
SPARE_RUNS = 5  # that may end by themselves before the last; a worker killed thrice while it starts ends its run


@dataclass(frozen=True, slots=True)
class Kill:
    """Who is killed (`run` or `worker`), so many new pictures after the last kill, and so many seconds after that."""

    who: str
    pictures: int
    delay_s: float


@dataclass(eq=False, slots=True)
class Course:
    """How a run went: who was killed how often, how often it was started until it had done all, and its pictures."""

    killed: dict[str, int] = field(default_factory=lambda: {"run": 0, "worker": 0})
    started: int = 0
    seconds: float = 0.0
    pictures: list[tuple[float, int]] = field(default_factory=list)  # (seconds, how many) whenever one is added
    kills: list[tuple[float, int]] = field(default_factory=list)


def draw_kills(n: int, *, rng: np.random.Generator) -> list[Kill]:
    """Random moments: one in four while Blender starts or loads, the others in the middle of a picture."""
    drawn = []
    for _ in range(n):
        starting = rng.random() < 0.25
        pictures = 0 if starting else int(rng.integers(1, 5))
        delay = rng.uniform(0.0, STARTING_S if starting else IMAGE_S)
        drawn.append(Kill(str(rng.choice(["run", "worker"])), pictures, float(delay)))
    return drawn


def render(plan: Path, dataset: Path, kills: Sequence[Kill] = ()) -> Course:
    """`hulldown render`, started again after each kill, until it says that all is done."""
    course, begun = Course(), time.perf_counter()
    left = list(kills)
    with (dataset.parent / f"{dataset.name}.log").open("ab") as log:
        while course.started <= len(kills) + SPARE_RUNS:
            course.started += 1
            command = [sys.executable, "-P", "-m", "cli", "render", str(plan), "-o", str(dataset), "--device", "cpu"]
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            run = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
            try:
                _strike(run, dataset, left, course, begun)
            finally:
                run.kill()
            if run.wait() == 0:
                course.seconds = time.perf_counter() - begun
                return course
    raise RuntimeError(f"not finished after {course.started} starts; see {log.name}")


def _strike(run: subprocess.Popen, dataset: Path, kills: list[Kill], course: Course, begun: float) -> None:
    """Watch a run to its end, which comes early if it is its turn to be killed; kills that were done are taken off."""
    then = now = _count(dataset)
    due: float | None = None
    while run.poll() is None:
        if (found := _count(dataset)) != now or not course.pictures:
            now = found
            course.pictures.append((time.perf_counter() - begun, now))
        if kills and due is None and now - then >= kills[0].pictures:
            due = time.perf_counter() + kills[0].delay_s
        if due is not None and time.perf_counter() >= due:
            children = psutil.Process(run.pid).children()
            if kills[0].who == "run" or children:
                kill = kills.pop(0)
                course.killed[kill.who] += 1
                course.kills.append((time.perf_counter() - begun, now))
                then, due = now, None
                victim = run if kill.who == "run" else children[-1]
                with contextlib.suppress(psutil.NoSuchProcess):
                    victim.kill()
                if kill.who == "run":
                    run.wait()
        time.sleep(POLL_S)


def _count(dataset: Path) -> int:
    try:
        return len(os.listdir(dataset / "images"))
    except FileNotFoundError:
        return 0


def differences(whole: Path, killed: Path) -> dict[str, int]:
    """How many images of one dataset are lost, doubled or other in the second; all 0 if they are equal.

    Parameters
    ----------
    whole, killed
        Folders of datasets. Compared are the records of annotations.json and every file, but logs and lock, by its
        bytes; of the journal the lines and not their order, which is that in which images were finished.
    """
    one, two = (json.loads((folder / "annotations.json").read_text()) for folder in (whole, killed))
    found = {}
    for kind in ("images", "annotations", "categories"):
        expected, seen = ({r["id"]: r for r in coco[kind]} for coco in (one, two))
        found[f"{kind} lost"] = len(expected.keys() - seen.keys())
        found[f"{kind} doubled"] = len(two[kind]) - len(seen) + len(seen.keys() - expected.keys())
        found[f"{kind} that differ"] = sum(expected[i] != seen[i] for i in expected.keys() & seen.keys())
    names = [record["file_name"] for record in two["images"]]
    found["file names doubled"] = len(names) - len(set(names))
    files, others = (_digests(folder) for folder in (whole, killed))
    found["files lost"] = len(files.keys() - others.keys())
    found["files too many"] = len(others.keys() - files.keys())
    found["files that differ"] = sum(files[n] != others[n] for n in files.keys() & others.keys())
    return found


def _digests(dataset: Path) -> dict[Path, str]:
    """Of every file that a run leaves behind to be used."""
    found = {}
    for path in sorted(p for p in dataset.rglob("*") if p.is_file()):
        name, content = path.relative_to(dataset), path.read_bytes()
        if name.parts[0] in (LOGS_NAME, LOCK_NAME):
            continue
        if name == Path(JOURNAL_NAME):
            lines = content.splitlines(keepends=True)
            content = b"".join(sorted(line for line in lines if line != MERGED))
        found[name] = hashlib.sha256(content).hexdigest()
    return found


def run(quick: bool) -> dict[str, Any]:
    """Measure."""
    kills = draw_kills(4 if quick else 25, rng=np.random.default_rng(3))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = create_project(folder, seed=0)
        plan, _ = planned(
            folder, config, 8 if quick else 40, SIZE, one_of_a_class=True, render={"profile": "fast", "samples": 2}
        )
        whole = render(plan.path, folder / "whole")
        killed = render(plan.path, folder / "killed", kills)
        found = differences(folder / "whole", folder / "killed")
        return {
            "size": SIZE,
            "images": len(plan),
            "killed": killed.killed,
            "started": killed.started,
            "differences": found,
            **{
                name: {"seconds": course.seconds, "pictures": course.pictures, "kills": course.kills}
                for name, course in (("whole", whole), ("interrupted", killed))
            },
        }


def report(results: dict) -> str:
    """A Markdown section."""
    whole, interrupted = results["whole"]["seconds"], results["interrupted"]["seconds"]
    killed = results["killed"]
    width, height = results["size"]
    wrong = {what: n for what, n in results["differences"].items() if n}
    lines = [
        "## Resuming",
        "",
        f"`hulldown render` of {results['images']} images ({width} x {height}) on the CPU, killed (SIGKILL) "
        f"{sum(killed.values())} times at random moments, and once more left alone. Compared are image records, "
        "annotations, categories and ids, and the bytes of every file but logs and lock: pictures, `annotations.json`, "
        "`provenance.json`; of the journal the lines, whose order is that in which images were finished.",
        "",
        "| | left alone | killed |",
        "|---|---:|---:|",
        f"| kills of the run | 0 | {killed['run']} |",
        f"| kills of its worker | 0 | {killed['worker']} |",
        f"| starts of `hulldown render` | 1 | {results['started']} |",
        f"| seconds | {whole:.0f} | {interrupted:.0f} |",
    ]
    for what, n in results["differences"].items():
        if n or what in ("images lost", "images doubled", "files lost", "files that differ", "annotations that differ"):
            lines.append(f"| {what} | 0 | {n} |")
    said = "**The two datasets differ.**" if wrong else "Everything compared is equal."
    return "\n".join([*lines, "", said])


def plots(results: dict, folder: Path) -> list[Path]:
    """Draw pictures against time."""
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.subplots()
    for name in ("whole", "interrupted"):
        steps = [*results[name]["pictures"], (results[name]["seconds"], results["images"])]
        axes.step(*zip(*steps, strict=True), where="post", label={"whole": "left alone"}.get(name, "killed"))
    if kills := results["interrupted"]["kills"]:
        axes.plot(*zip(*kills, strict=True), "kx", markersize=5, label="a kill")
    axes.set(xlabel="seconds", ylabel="pictures in the dataset", ylim=(0, None), xlim=(0, None))
    axes.legend()
    path = folder / "resuming.png"
    figure.savefig(path, dpi=120)
    return [path]
