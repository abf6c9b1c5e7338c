"""Train a study's runs, one after the other.

Several processes may do so at once, on several GPUs or machines that share the folder: each takes the next run on
which no other is at work.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias

from hulldown.base.arguments import AnyPath
from hulldown.base.errors import HulldownError
from hulldown.base.outputs import OutputBusy, OutputFolder
from hulldown.base.terminal import one_bar_per_title
from hulldown.base.terminal import print_message as show_line
from hulldown.training.detectors.detector import usable_torch_device
from hulldown.training.inputs.extra import require_training_extra
from hulldown.training.predict import predict_detections
from hulldown.training.study.config import load_study_config
from hulldown.training.study.study_folder import (
    RUNS_NAME,
    STUDY_NAME,
    Study,
    StudyRun,
    is_run_finished,
    planned_study_runs,
    prepare_study,
    study_warnings,
)
from hulldown.training.train import prepare_trainee, train_detector

ReportProgress: TypeAlias = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class StudyOutcome:
    """The outcomes of a study's runs, by their names."""

    finished: tuple[str, ...]  # finished now
    already: tuple[str, ...]  # finished before
    elsewhere: tuple[str, ...]  # other processes are at work on these
    failed: Mapping[str, str]  # reasons; the next call tries them again


def train_study(
    config: AnyPath,
    output: AnyPath,
    *,
    device: str = "auto",
    workers: int | None = None,
    progress: ReportProgress | None = None,
    say: Callable[[str], None] = show_line,
) -> StudyOutcome:
    """Train and evaluate the unfinished runs of a study.

    Reads a config and its datasets; writes a folder of runs. The same call continues after a stop and skips finished
    runs; failed runs are listed with reasons. It may run several times at once, such as once for each GPU.

    Parameters
    ----------
    config
        The config; see docs/study.md.
    output
        The study's folder.
    device
        auto, cpu, gpu, or PyTorch's name of a device, such as cuda:1; auto is a GPU if there is one.
    workers
        Processes that read and augment pictures; by default one per core but one.
    progress
        Called with (title, steps done, all); None: bars in a terminal or notebook.
    say
        Called with messages for the user.
    """
    asked, out = load_study_config(Path(config)), Path(output)
    require_training_extra()
    # Not at the top: this module can be imported without the extra.
    from hulldown.training.inputs.augment import Augmenter

    if progress is None:
        with one_bar_per_title() as bars:
            return train_study(config, output, device=device, workers=workers, progress=bars, say=say)
    Augmenter(asked.train.augmentation)  # refuses a wrong file
    with OutputFolder(out, "study", [STUDY_NAME]):
        study = prepare_study(asked, out)
    # Downloads the weights once, or refuses them, before a run begins.
    prepare_trainee(asked.train, study.classes, usable_torch_device(device), out)
    for line in study_warnings(study, out):
        warnings.warn(line, stacklevel=2)
    runs = planned_study_runs(study.config)
    already = tuple(run.name for run in runs if is_run_finished(out, study, run))
    say(f"{len(already)} of {len(runs)} runs are finished")
    finished, elsewhere, failed = [], [], {}
    for number, run in enumerate(runs, start=1):
        if run.name in already:
            continue
        told = partial(_report_progress, progress, f"{run.name} ({number} of {len(runs)})")
        try:
            _train_and_predict_run(run, study, out, device=device, workers=workers, progress=told)
        except OutputBusy:
            elsewhere.append(run.name)
        except HulldownError as error:
            failed[run.name] = str(error)
            say(f"{run.name}: set aside: {error}")
        else:
            finished.append(run.name)
            say(f"{run.name}: finished")
    return StudyOutcome(tuple(finished), already, tuple(elsewhere), failed)


def _report_progress(progress: ReportProgress, run: str, what: str, done: int, total: int) -> None:
    progress(f"{run}: {what}", done, total)


def _train_and_predict_run(
    run: StudyRun, study: Study, out: Path, *, device: str, workers: int | None, progress: ReportProgress
) -> None:
    folder = out / RUNS_NAME / run.name
    train_detector(
        run.data(study, out), folder, settings=run.settings, workers=workers, device=device, progress=progress,
        say=lambda line: None,
    )  # fmt: skip
    for which in study.judged_dataset_names:
        if not (folder / f"{which}.json").exists():
            looking = partial(progress, f"looking at {which}")
            predict_detections(folder, study.datasets[which].folder, folder / f"{which}.json", device=device, progress=looking)
