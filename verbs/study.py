"""The verb study: init, run, report."""

from __future__ import annotations

import argparse
from contextlib import nullcontext
from pathlib import Path

from hulldown.base.terminal import progress_bars, say, warn
from hulldown.verbs.arguments import Subparsers, add_verb
from hulldown.verbs.cluster import add_scheduler, scheduler_of, training_workers
from hulldown.verbs.output import DONE, FOUND, show_result


def _init(arguments: argparse.Namespace) -> None:
    from hulldown.training.study.config import write_study

    output, folders = arguments.output, ("real", "synthetic", "test", "valid")
    write_study(output, **{key: getattr(arguments, key) for key in folders})
    say(f"wrote {output}; next: hulldown study run {output} -o STUDY")


def _run(arguments: argparse.Namespace) -> int:
    from hulldown.training.inputs.extra import require_extra
    from hulldown.training.study.config import load_study

    config = load_study(arguments.config)
    require_extra()
    from hulldown.training.detectors.detector import chosen_device
    from hulldown.training.inputs.augment import Augmenter
    from hulldown.training.study.manifest import settle
    from hulldown.training.study.runs import RunOptions, run_study
    from hulldown.training.train import prepare_trainee

    Augmenter(config.train.augmentation)  # refuses a wrong one
    manifest = settle(config)
    for line in manifest.warnings:
        warn(line)
    options = RunOptions(arguments.device, arguments.workers)
    # Downloads the weights once, or refuses them, before a run begins.
    prepare_trainee(config.train, manifest.classes, chosen_device(arguments.device), arguments.output)
    scheduler = scheduler_of(arguments)
    with progress_bars() as advance, training_workers(scheduler) if scheduler else nullcontext() as launch:
        done = run_study(manifest, arguments.output, options=options, launch=launch, progress=advance, say=say)
    show_result(arguments, done)
    for name, reason in done.failed.items():
        warn(f"{name} was set aside: {reason}")
    say(
        f"{len(done.finished) + len(done.already)} of {len(manifest.runs)} runs are finished; "
        f"next: hulldown study report {arguments.output}"
    )
    return FOUND if done.failed else DONE


def _report(arguments: argparse.Namespace) -> None:
    from hulldown.training.study.study_report import write_report

    found = write_report(arguments.study)
    show_result(arguments, found)
    for line in found.summary:
        say(line)
    say(f"look at {arguments.study / 'report.html'}")


def add(verbs: Subparsers) -> None:
    """Add this verb to the command."""
    does = "measure the worth of synthetic images when photographs are few"
    study = add_verb(
        verbs,
        "study",
        _report,
        does,
        "Trains one detector after the other, as the paper does, and compares them.",
        json=False,
    )
    steps = study.add_subparsers(required=True, metavar="STEP")

    sub = add_verb(steps, "init", _init, "write a config", "Comments tell what each key means.", json=False)
    for key, text in {
        "real": "photographs to train on", "synthetic": "rendered images to train on",
        "test": "photographs to test on",
    }.items():  # fmt: skip
        sub.add_argument(f"--{key}", type=Path, metavar="DIR", required=True, help=text)
    sub.add_argument("--valid", type=Path, metavar="DIR", help="photographs to choose confidence thresholds on")
    sub.add_argument("-o", "--output", type=Path, metavar="CONFIG", required=True, help="such as study.toml")

    sub = add_verb(
        steps, "run", _run, "train and evaluate the unfinished runs",
        "Reads a config and its datasets; writes a folder of runs. The same command continues after a stop and skips "
        "finished runs; failed runs are listed with reasons.",
        resumes=True,
    )  # fmt: skip
    sub.add_argument("config", type=Path, metavar="CONFIG", help="see docs/study.md")
    sub.add_argument("-o", "--output", type=Path, metavar="STUDY", required=True, help="the study's folder")
    sub.add_argument("--device", default="auto", choices=("auto", "cpu", "gpu"), help="default: auto, GPUs if any")
    sub.add_argument(
        "--workers", type=int, help="processes of a run that augment pictures (default: one per core but one)"
    )
    add_scheduler(
        sub, "train on the workers of a Dask cluster, which see all these folders: tcp://HOST:8786, or its .json file"
    )

    sub = add_verb(
        steps, "report", _report, "compare the arms",
        "Reads a study, finished or not; writes report.html, report.json, and charts into it.",
    )  # fmt: skip
    sub.add_argument("study", type=Path, metavar="STUDY", help="folder of `hulldown study run`")
