"""Train and evaluate all runs of a study, on this machine or on a cluster."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from pathlib import Path

from hulldown.base.arguments import AnyPath
from hulldown.base.terminal import progress_bars, say
from hulldown.cluster.scheduler import Scheduler
from hulldown.training.detectors.detector import chosen_device
from hulldown.training.inputs.extra import require_extra
from hulldown.training.study.cluster_runs import training_workers
from hulldown.training.study.config import load_study
from hulldown.training.study.manifest import settle
from hulldown.training.study.runs import Done, RunOptions, run_study
from hulldown.training.train import prepare_trainee

DEFAULTS = RunOptions()


def train_study(
    config: AnyPath,
    output: AnyPath,
    *,
    options: RunOptions = DEFAULTS,
    scheduler: Scheduler | None = None,
) -> Done:
    """Train and evaluate the unfinished runs of a study.

    Reads a config and its datasets; writes a folder of runs. The same call continues after a stop and skips finished
    runs; failed runs are listed with reasons.

    Parameters
    ----------
    config
        The config; see docs/study.md.
    output
        The study's folder.
    options
        Options of running.
    scheduler
        Of a Dask cluster whose workers train.
    """
    study, folder = load_study(Path(config)), Path(output)
    require_extra()
    # Not at the top: this module can be imported without the extra.
    from hulldown.training.inputs.augment import Augmenter

    Augmenter(study.train.augmentation)  # refuses a wrong one
    manifest = settle(study)
    for line in manifest.warnings:
        warnings.warn(line, stacklevel=2)
    # Downloads the weights once, or refuses them, before a run begins.
    prepare_trainee(study.train, manifest.classes, chosen_device(options.device), folder)
    with progress_bars() as advance, training_workers(scheduler) if scheduler else nullcontext() as launch:
        return run_study(manifest, folder, options=options, launch=launch, progress=advance, say=say)
