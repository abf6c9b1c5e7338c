"""What a run of a study does in its own process: train and predict; and verbs of hulldown in processes of theirs.

`python -m hulldown.training.study.run_process run STUDY NAME DEVICE [WORKERS]` does a run, with progress as JSON lines
on stdout. `... verb VERB ...` is `hulldown VERB ...`, interrupted when its parent ends: the arm `loop` plans and
renders this way, since training imports neither.
"""

from __future__ import annotations

import json
import os
import runpy
import signal
import sys
from functools import partial
from pathlib import Path

from hulldown.base.child import Child, end_with_parent
from hulldown.base.errors import HulldownError
from hulldown.training.inputs.extra import require_extra
from hulldown.training.study.manifest import (
    RUNS_NAME,
    Manifest,
    PlannedRun,
    draws_path,
    predictions_paths,
    read_manifest,
)
from hulldown.training.study.runs import Progress, RunOptions

LOOPS_NAME = "loops"


def run_one(study: Path, name: str, options: RunOptions, progress: Progress) -> None:
    """Train the run with this name in study.json, and predict on the test and validation pictures.

    An interrupted run continues. `progress` is called with (title, steps done, all).

    Raises
    ------
    HulldownError
        If a file or setting is unusable.
    """
    from hulldown.training.predict import predict
    from hulldown.training.train import train

    manifest = read_manifest(study)
    run = manifest.run(name)
    folder = study / RUNS_NAME / run.folder
    if run.base == "loop":
        _train_loop(study, manifest, run, options, progress)
    else:
        train(
            {source: manifest.datasets[source].folder for source in run.sources}, folder, settings=run.settings,
            draws_file=draws_path(study, run), workers=options.workers, device=options.device, progress=progress,
        )  # fmt: skip
    for which, found in predictions_paths(study, manifest, run).items():
        if not found.exists():
            looking = partial(progress, f"looking at {which}")
            predict(folder, manifest.datasets[which].folder, found, device=options.device, progress=looking)


def _train_loop(study: Path, manifest: Manifest, run: PlannedRun, options: RunOptions, progress: Progress) -> None:
    """Train a run of the arm; an interrupted one continues.

    The first detector has the draws of the arm `synthetic`. The second has the same budget and settings, and draws from
    the synthetic images and the rendered ones, each image equally likely.

    Raises
    ------
    HulldownError
        If a verb fails, with its last line.
    """
    from hulldown.training.evaluation.evaluation_report import evaluate_files
    from hulldown.training.predict import predict
    from hulldown.training.train import train

    workers, device = options.workers, options.device
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
    command = [sys.executable, "-P", "-m", "hulldown.training.study.run_process", "verb", *arguments]
    with Child(command, env=os.environ, hear=lambda line: None, log=log) as child:
        code = child.wait()
    if code:
        raise HulldownError(f"hulldown {arguments[0]}: {child.last_words()}", path=log, remedy="look at the file")


def _run(study: str, name: str, device: str, *workers: str) -> int:
    """Do a run in this process; return the exit code."""
    end_with_parent(getattr(signal, "SIGKILL", signal.SIGTERM))  # Windows has no SIGKILL
    try:
        require_extra()
        run_one(Path(study), name, RunOptions(device, int(workers[0]) if workers else None), _tell)
    except HulldownError as error:
        print(json.dumps({"failed": str(error)}), flush=True)
        return 1
    return 0


def _tell(what: str, done: int, total: int) -> None:
    print(json.dumps({"what": what, "done": done, "total": total}), flush=True)


if __name__ == "__main__":
    if sys.argv.pop(1) == "run":
        sys.exit(_run(*sys.argv[1:]))
    end_with_parent(signal.SIGINT)
    runpy.run_module("hulldown.cli", run_name="__main__")
