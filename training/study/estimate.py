"""Estimate the duration of a study."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from hulldown.training.detectors.detector import RUN_NAME, read_run
from hulldown.training.study.manifest import RUNS_NAME, Manifest
from hulldown.training.study.runs import RunOptions, is_finished

TRIED_STEPS = 3


@dataclass(frozen=True, slots=True)
class RunState:
    """A run of a study: its images, its draws and steps, draws per image, and whether it's finished."""

    name: str
    photographs: int
    synthetic_images: int
    draws: int
    steps: int
    draws_per_photograph: float
    draws_per_synthetic_image: float
    state: Literal["finished", "begun", "new"]


def overview(study: Path, manifest: Manifest) -> list[RunState]:
    """Return the state of each run. The study may not have begun."""
    rows = []
    for run in manifest.runs:
        settings, begun = run.settings, (study / RUNS_NAME / run.folder).exists()
        synthetic = manifest.datasets["synthetic"].images if "synthetic" in run.sources else 0
        row = RunState(
            name=run.name,
            photographs=run.photographs,
            synthetic_images=synthetic,
            draws=settings.budget,
            steps=settings.steps,
            draws_per_photograph=run.drawn.get("real", 0) / max(1, run.photographs),
            draws_per_synthetic_image=run.drawn.get("synthetic", 0) / max(1, synthetic),
            state="finished" if is_finished(study, manifest, run) else "begun" if begun else "new",
        )
        rows.append(row)
    return rows


def seconds_per_step(
    study: Path, manifest: Manifest, options: RunOptions, *, say: Callable[[str], None] = lambda line: None
) -> float:
    """Seconds per step: of finished runs, else of three steps that are run as a test."""
    folders = (study / RUNS_NAME / run.folder for run in manifest.runs)
    known = [read_run(folder).figures.seconds_per_step for folder in folders if (folder / RUN_NAME).exists()]
    if found := [seconds for seconds in known if seconds is not None]:
        return float(np.median(found))
    from hulldown.training.train import train

    say(f"taking {TRIED_STEPS} steps to see how long one takes")
    settings = manifest.runs[0].settings
    tried = settings.model_copy(update={"budget": TRIED_STEPS * settings.effective_batch, "weights": "none"})
    source = manifest.runs[0].sources[0]
    with TemporaryDirectory() as place:
        tried_run = train(
            {source: manifest.datasets[source].folder}, Path(place) / "run", settings=tried, device=options.device,
            workers=options.workers,
        )  # fmt: skip
    assert tried_run.figures.seconds_per_step is not None, "it's finished"
    return tried_run.figures.seconds_per_step


def hours(rows: Sequence[RunState], seconds: float, places: int) -> float:
    """Remaining hours of training, with some runs at the same time."""
    return sum(row.steps for row in rows if row.state != "finished") * seconds / places / 3600.0
