"""Kill `hulldown render` again and again, and compare the dataset with that of an undisturbed run.

Runs and workers are killed without warning (SIGKILL).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from hulldown.dataset.coco import LOCK_NAME
from hulldown.dataset.store.document import JOURNAL_NAME
from hulldown.dataset.store.journal import MERGED
from hulldown.render.session import LOGS_NAME

ROOT = Path(__file__).parents[2]
POLL_S = 0.01
SPARE_RUNS = 5  # that may end by themselves before the last; a worker killed three times while starting ends its run


@dataclass(frozen=True, slots=True)
class Kill:
    """Kill `run` or `worker` this many pictures after the last kill, plus this many seconds."""

    who: str
    pictures: int
    delay_s: float


@dataclass(eq=False, slots=True)
class Course:
    """The kills of each victim, and the number of starts."""

    killed: dict[str, int] = field(default_factory=lambda: {"run": 0, "worker": 0})
    started: int = 0


def render(plan: Path, dataset: Path, kills: Sequence[Kill] = ()) -> Course:
    """Run `hulldown render`, start it again after each kill, and stop when it exits with 0."""
    course, left = Course(), list(kills)
    with (dataset.parent / f"{dataset.name}.log").open("ab") as log:
        while course.started <= len(kills) + SPARE_RUNS:
            course.started += 1
            command = [sys.executable, "-P", "-m", "hulldown.cli", "render", str(plan), "-o", str(dataset)]
            command += ["--device", "cpu"]
            environment = {**os.environ, "PYTHONPATH": str(ROOT / ".dev")}
            run = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
            try:
                _strike(run, dataset, left, course)
            finally:
                run.kill()
            if run.wait() == 0:
                return course
    raise RuntimeError(f"not finished after {course.started} starts; see {log.name}")


def _strike(run: subprocess.Popen, dataset: Path, kills: list[Kill], course: Course) -> None:
    """Watch a run to its end and kill its victims; completed kills are removed from the list."""
    then = now = _count(dataset)
    due: float | None = None
    while run.poll() is None:
        now = _count(dataset)
        if kills and due is None and now - then >= kills[0].pictures:
            due = time.perf_counter() + kills[0].delay_s
        if due is not None and time.perf_counter() >= due:
            children = psutil.Process(run.pid).children()
            if kills[0].who == "run" or children:
                kill = kills.pop(0)
                course.killed[kill.who] += 1
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
    """Count the files that are lost, too many, or different in the second of two datasets; all 0 if they are equal.

    Parameters
    ----------
    whole, killed
        Folders of datasets. The bytes of every file except logs and lock are compared; the journal by its lines in any
        order, since images finish in any order.
    """
    files, others = (_digests(folder) for folder in (whole, killed))
    return {
        "files lost": len(files.keys() - others.keys()),
        "files too many": len(others.keys() - files.keys()),
        "files that differ": sum(files[n] != others[n] for n in files.keys() & others.keys()),
    }


def _digests(dataset: Path) -> dict[Path, str]:
    """Hashes of the files that a run leaves behind."""
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
