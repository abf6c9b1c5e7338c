"""The arm `loop`: train, evaluate on validation photographs, plan and render more of what was missed, train again.

Planning and rendering are verbs in separate processes, since training doesn't import them: `python -m
hulldown.training.study.loop VERB ...` is `hulldown VERB ...`, interrupted when its parent ends.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from hulldown.geometry.child import Child, end_with_parent
from hulldown.geometry.errors import HulldownError
from hulldown.training.study.manifest import RUNS_NAME, Manifest, PlannedRun, draws_path

LOOPS_NAME = "loops"


def train_loop(
    study: Path,
    manifest: Manifest,
    run: PlannedRun,
    *,
    workers: int | None,
    device: str,
    progress: Callable[[str, int, int], None],
) -> None:
    """Train a run of the arm; an interrupted one continues.

    The first detector has the draws of the arm `synthetic`. The second has the same budget and settings, and draws from
    the synthetic images and the rendered ones, each image equally likely.

    Raises
    ------
    HulldownError
        If a verb fails, with its last line.
    """
    from hulldown.training.evaluation.report import evaluate_files
    from hulldown.training.predict import predict
    from hulldown.training.train import train

    begun = study / LOOPS_NAME / run.folder
    first, plan, more, found = (begun / name for name in ("first", "more.jsonl", "more", "valid.json"))
    synthetic, valid = manifest.datasets["synthetic"].folder, manifest.datasets["valid"].folder
    if not plan.exists():
        train(
            {"synthetic": synthetic}, first, settings=run.settings, draws_file=draws_path(study, run),
            workers=workers, device=device, progress=progress,
        )  # fmt: skip
        if not found.exists():
            predict(first, valid, found, device=device, progress=partial(progress, "looking at valid"))
        evaluate_files(valid, found, begun / "evaluation", threshold="best", progress=partial(progress, "evaluating"))
        report = begun / "evaluation" / "report.json"
        _hulldown("plan", str(manifest.config.plan), "-o", str(plan), "--more-of", str(report), log=begun / "plan.txt")
    _hulldown("render", str(plan), "-o", str(more), "--device", device, log=begun / "render.txt")
    train(
        {"synthetic": synthetic, "more": str(more)}, study / RUNS_NAME / run.folder, settings=run.settings,
        workers=workers, device=device, progress=progress,
    )  # fmt: skip


def _hulldown(*arguments: str, log: Path) -> None:
    """Run a verb to its end."""
    log.unlink(missing_ok=True)
    command = [sys.executable, "-P", "-m", "hulldown.training.study.loop", *arguments]
    with Child(command, env=os.environ, hear=lambda line: None, log=log) as child:
        code = child.wait()
    if code:
        raise HulldownError(f"hulldown {arguments[0]}: {child.last_words()}", path=log, remedy="look at the file")


if __name__ == "__main__":
    end_with_parent(signal.SIGINT)
    runpy.run_module("hulldown.cli", run_name="__main__")
